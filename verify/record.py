#!/usr/bin/env python3
"""The session record on real file systems: kills, full, read-only and frozen disks, two daemons on one folder.

    verify/record.py PROGRAM     as root, because it mounts; SEED and ROUNDS [20] are variables of the environment

A client plays and answers while the disk fails or the daemon is killed. Then a new daemon reads the record: each answer
that was acknowledged is in it, or it says that the session lacks something; none stands there that was refused. Prints
a table, and exits 1 if that does not hold.
"""
import atexit, http.client, json, os, random, shutil, signal, socket, subprocess, sys, tempfile, threading, time
from pathlib import Path

PROGRAM, SEED, ROUNDS = Path(sys.argv[1]).resolve(), os.environ.get("SEED", "1"), int(os.environ.get("ROUNDS", "20"))
FOLDER = Path(tempfile.mkdtemp(prefix="record-"))
DAEMONS = []
random.seed(SEED)


@atexit.register
def clean():
    for daemon in DAEMONS:
        daemon.kill()
        daemon.wait()
    for disk in filter(os.path.ismount, FOLDER.iterdir()):
        run("umount", disk)
    shutil.rmtree(FOLDER)


class Unix(http.client.HTTPConnection):
    def connect(self):
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.settimeout(70)
        self.sock.connect(self.host)


class Daemon:
    def __init__(self, disk, name="a"):
        self.socket, self.token, self.stops = f"{FOLDER}/{name}.sock", None, False
        self.accepted, self.acked, self.refused, self.said = 0, set(), set(), set()
        config = FOLDER / f"{name}.toml"
        config.write_text(f'logbook_dir = "{disk}/logbook"\n')
        command = [PROGRAM, "daemon", "--device", "mock", "--socket", self.socket, "--config", config]
        self.process = subprocess.Popen(command, stderr=(FOLDER / f"{name}.log").open("a"))
        DAEMONS.append(self.process)
        while self.ask("GET", "/v1/status")[0] != 200:
            time.sleep(0.05)

    def ask(self, method, path, body=None):
        """The status of the answer, 0 if there is none, and its text as JSON."""
        headers = {"Host": "meissner"} | ({"Authorization": f"Bearer {self.token}"} if self.token else {})
        try:
            connection = Unix(self.socket)
            connection.request(method, path, None if body is None else json.dumps(body), headers)
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read() or b"null")
        except (OSError, http.client.HTTPException):
            return 0, None

    def session(self, record="required"):
        self.ask("POST", "/v1/arm", {"assume_rest": True})
        status, started = self.ask("POST", "/v1/sessions", {"participant": "P07", "record": record})
        if status == 201:
            self.token, self.id = started["token"], started["id"]
        return status

    def work(self):
        """Plays and answers until told to stop, or the daemon is gone."""
        while not self.stops and self.process.poll() is None:
            status, play = self.ask("POST", "/v1/play", {"pattern": "pin-60", "seconds": 0.02})
            problem = ((self.ask("GET", "/v1/status")[1] or {}).get("daemon") or {}).get("logbook_problem")
            self.said |= {"status"} if problem else set()
            if status not in (200, 202):
                time.sleep(0.05)
                continue
            self.accepted += 1
            self.ask("GET", f"/v1/plays/{play['id']}?wait=60")
            status, _ = self.ask("POST", f"/v1/plays/{play['id']}/answer", {"response": "left"})
            (self.acked if status in (200, 201) else self.refused if status else set()).add(play["id"])

    def start(self):
        self.thread = threading.Thread(target=self.work)
        self.thread.start()

    def stop(self, kill=False):
        self.stops = True
        if not kill:
            self.thread.join()
            ended = self.ask("POST", "/v1/sessions/running/end", {})[1] or {}
            self.said |= {"end"} if any((ended.get("lost") or {}).values()) else set()
        self.process.send_signal(signal.SIGKILL if kill else signal.SIGTERM)
        self.process.wait()
        self.thread.join()


def run(*command):
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def mount(kind, mounted):
    mounted.mkdir()
    if kind == "tmpfs":
        return run("mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", mounted)
    image = mounted.with_suffix(".img")
    run("truncate", "-s", "8M", image)
    run("mkfs.ext4", "-q", image)
    run("mount", "-o", "loop,errors=remount-ro", image, mounted)


def full(disk):
    with (disk / "ballast").open("wb", buffering=0) as ballast:
        try:
            while ballast.write(bytes(4096)):
                pass
        except OSError:
            time.sleep(3)
    (disk / "ballast").unlink()


def frozen(disk):
    run("fsfreeze", "-f", disk)
    time.sleep(10)
    run("fsfreeze", "-u", disk)


def read_only(disk):
    device = Path(subprocess.check_output(["findmnt", "-no", "SOURCE", disk], text=True).strip()).name
    Path(f"/sys/fs/ext4/{device}/trigger_fs_error").write_text("1")
    time.sleep(3)


def case(what, kind, harm, rounds, record="required", kill=False):
    """A row of the table, and whether it holds."""
    disk, sums, said, holds = FOLDER / f"{what}-{kind}-{record}".replace(" ", "-"), [0] * 5, set(), True
    mount(kind, disk)
    for _ in range(rounds):
        daemon = Daemon(disk)
        second = harm(disk) if harm is two else None
        if daemon.session(record) != 201:
            sys.exit(f"{what}: no session started: {(FOLDER / 'a.log').read_text()[-2000:]}")
        daemon.start()
        time.sleep(random.uniform(0.2, 2))
        if harm and harm is not two:
            harm(disk)
            time.sleep(2)
        daemon.stop(kill)
        if harm is read_only:
            run("umount", disk)
            subprocess.run(["e2fsck", "-fy", f"{disk}.img"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            run("mount", "-o", "loop", f"{disk}.img", disk)
        reader = Daemon(disk)
        status, found = reader.ask("GET", f"/v1/sessions/{daemon.id}/plays")
        listed = reader.ask("GET", "/v1/sessions")[1]
        kept = {play["receipt"]["id"] for play in found["plays"] if play["answer"]} if status == 200 else set()
        missing = found["missing"] if status == 200 else listed["problems"]
        says = daemon.said | ({"reader"} if missing else set()) | (second or set())
        gone, wrong = daemon.acked - kept, kept & daemon.refused
        plays = len(found["plays"]) if status == 200 else 0
        is_good = not wrong and (says or not gone) and (says or plays == daemon.accepted)
        if not is_good:
            print(f"{what}: gone {gone}, refused but there {wrong}, plays {plays} of {daemon.accepted}", file=sys.stderr)
        holds, said = holds and is_good, said | says
        reader.process.terminate()
        reader.process.wait()
        for at, n in enumerate([daemon.accepted, len(daemon.acked), len(kept), len(daemon.refused), len(gone)]):
            sums[at] += n
    run("umount", disk)
    print(f"| {what} | {kind} | {rounds} | {' | '.join(map(str, sums))} | {', '.join(sorted(said)) or '-'} |", flush=True)
    return holds


def two(disk):
    """A second daemon on the folder starts no session, and an optional one says what it lost."""
    other, said = Daemon(disk, "b"), set()
    if other.session() == 503 or other.token is None:
        said.add("refused")
    if other.session("optional") == 201:
        other.start()
        time.sleep(1)
        other.stop()
    if other.accepted and not other.acked and "end" in other.said and "refused" in said:
        return set()
    sys.exit(f"two daemons: {said}, {other.said}, {other.accepted} plays, {other.acked}")


print("| what | disk | rounds | plays | answers acknowledged | found | refused | gone | said by |\n|" + "---|" * 9)
cases = [("killed", "ext4", None, ROUNDS, "required", True), ("killed", "tmpfs", None, ROUNDS, "required", True)]
for record in ("required", "optional"):
    cases += [("full", kind, full, 1, record) for kind in ("ext4", "tmpfs")]
    cases += [("frozen for 10 s", "ext4", frozen, 1, record), ("read-only", "ext4", read_only, 1, record)]
cases += [("full, then killed", "ext4", full, 3, "required", True), ("two daemons", "ext4", two, 1)]
results = [case(f"{row[0]}, optional" if row[4:5] == ("optional",) else row[0], *row[1:]) for row in cases]
sys.exit(not all(results))
