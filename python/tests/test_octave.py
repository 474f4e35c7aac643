"""`Meissner.m` in Octave, over TCP. Without Octave these tests are left out."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

import meissner
from network import Network
from patience import run_kept

OCTAVE = shutil.which("octave-cli")
MATLAB = Path(__file__).parents[1] / "matlab"


def why_not() -> str:
    """What these tests lack; empty: nothing."""
    if OCTAVE is None or shutil.which("curl") is None:
        return "Octave or curl is not installed"
    command = [OCTAVE, "--norc", "--quiet", "--eval", "exit(~exist('jsondecode'))"]
    has_json = subprocess.run(command, capture_output=True, check=False).returncode == 0
    return "" if has_json else "Octave has no `jsondecode`, which came with Octave 7"


WHY_NOT = why_not()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)


def octave(script: str, folder: Path, network: Network) -> str:
    """Runs a script, and returns what it prints."""
    assert OCTAVE is not None
    (folder / "script_of_the_test.m").write_text(script, encoding="utf-8")
    command = [OCTAVE, "--norc", "--quiet", "script_of_the_test.m"]
    ended = run_kept(command, folder, {"MEISSNER_URL": network.url})
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def begin(script: str) -> str:
    """A client whose clock is the wall clock, which this test can read, too."""
    return f"addpath('{MATLAB}');\nm = Meissner(getenv('MEISSNER_URL'), 'clock', @time);\n" + script


PLAYS = """
m.arm('assume_rest', true, 'checked', 'a test');
answers = {};
for number = 1:5
  asked = m.now() + 1.5;
  play = m.play('pin-60', 'seconds', 0.05, 'at', asked, 'scale', 0.5, 'trial', number, 'labels', struct('n', number), 'trigger', number);
  r = m.wait(play);
  answers{end + 1} = struct('id', r.id, 'state', r.state, 'asked', asked, 'onset', r.onset, 'offset', r.offset);
end
second = m.wait(m.play('pin-60', 'seconds', 0.05, 'at', m.later(r.onset, 3), 'trigger', false));
m.close();
state = m.status();
out = struct('plays', {answers}, 'apart', second.onset.tick - r.onset.tick, 'trigger', second.raw.items(1).trigger, 'state', state.state, ...
  'array', {{m.array.name, size(m.array.positions_mm, 1), m.array.tick_hz}});
disp(jsonencode(out));
"""


def test_onsets_err_by_less_than_stated_and_are_exact_to_the_tick(
    daemon: meissner.Daemon, network: Network, tmp_path: Path
) -> None:
    told: dict[str, Any] = json.loads(octave(begin(PLAYS), tmp_path, network))
    assert (told["apart"], told["trigger"]) == (3 * 85_000, [])
    assert told["array"] == ["tula35-6x4", 24, 85_000]
    assert told["state"] in ("returning", "disarmed")
    with meissner.connect(daemon.socket) as m:
        for number, play in enumerate(told["plays"], 1):
            receipt = m.receipt(play["id"])
            order, (item,) = receipt.raw["order"], receipt.raw["items"]
            assert (order["trial"], order["labels"]) == (number, {"n": str(number)})
            assert (item["scale"], item["trigger"]["code"]) == (0.5, number)
            for name, instant in (("onset", receipt.onset), ("offset", receipt.offset)):
                assert instant is not None
                assert play[name]["tick"] == instant.tick
                # On this machine Octave's `time` is the wall clock of `instant.wall`.
                error = abs(play[name]["time"] - instant.wall)
                assert error <= play[name]["uncertainty"] + instant.wall_uncertainty, f"{error} s"
                assert play[name]["uncertainty"] < 0.5
            assert abs(play["onset"]["time"] - play["asked"]) <= 2 * play["onset"]["uncertainty"] + 0.5 / 85_000


REST = """
m.arm('assume_rest', true, 'checked', 'a test');
id = m.session('participant', 'P07', 'experiment', 'octave', 'exclusive', true, 'seed', 3);
asked = m.play('pin-60', 'seconds', 0.05, 'hold', 10);
m.wait(asked);
m.answer(asked, 'left', 'correct', true, 'factors', struct('block', 2));
m.session_end();
long = m.play('pin-60', 'endless', true);
m.stop();
told = {};
tries = {@() m.wait(long), @() m.play('no-such'), @() m.play('pin-60', 'at', struct('tick', 1, 'boot', 1)), @() m.play('pin-60', 'second', 1), ...
  @() m.receipt(999999)};
for number = 1:numel(tries)
  try
    tries{number}();
    told{end + 1} = 'no error';
  catch failure
    told{end + 1} = failure.identifier;
  end
end
last = m.receipt();
m.estop();
faulted = m.status();
m.reset('force', true);
m.disarm();
out = struct('session', id, 'told', {told}, 'last', last.id == long.id, 'faulted', faulted.state);
disp(jsonencode(out));
"""


def test_sessions_and_errors_are_as_in_python(daemon: meissner.Daemon, network: Network, tmp_path: Path) -> None:
    told: dict[str, Any] = json.loads(octave(begin(REST), tmp_path, network))
    assert (told["last"], told["faulted"]) == (True, "faulted")
    assert told["told"] == [
        "meissner:play_stopped",
        "meissner:not_found",
        "meissner:stale_boot",
        "meissner:bad_option",
        "meissner:not_found",
    ]
    with meissner.connect(daemon.socket) as m:
        recorded = m.session_plays(told["session"])
        answer, session = recorded["plays"][-1]["answer"], recorded["session"]
        assert (answer["response"], answer["correct"], answer["factors"]) == ("left", True, {"block": "2"})
        assert (session["participant"], session["experiment"], session["seed"]) == ("P07", "octave", 3)
        assert session["exclusive"]
        assert session["reason"] == "request"


OVER = """
m.arm('assume_rest', true, 'checked', 'a test');
over = m.session('participant', 'P07');
first = m.wait(m.play('pin-60', 'seconds', 0.05));
other = Meissner(getenv('MEISSNER_URL'));
system(sprintf('curl --silent --show-error --fail -X POST %s/v1/sessions/%s/end >&2', getenv('MEISSNER_URL'), over));
next = other.session('participant', 'P08');
told = 'no error';
try
  m.play('pin-60', 'seconds', 0.05);
catch failure
  told = failure.identifier;
end
m.session_end();
still = other.status();
other.session_end();
ended = other.status();
again = m.session('participant', 'P07');
second = m.wait(m.play('pin-60', 'seconds', 0.05));
m.session_end();
m.close();
out = struct('over', over, 'next', next, 'again', again, 'told', told, 'still', still.session.id, 'ended', isempty(ended.session), ...
  'first', first.raw.order.session, 'second', second.raw.order.session);
disp(jsonencode(out));
"""


def test_after_the_session_is_over_nothing_plays(daemon: meissner.Daemon, network: Network, tmp_path: Path) -> None:
    told: dict[str, Any] = json.loads(octave(begin(OVER), tmp_path, network))
    assert told["told"] == "meissner:session_over"
    # Leaving a session that is over does not end that of somebody else.
    assert (told["still"], told["ended"]) == (told["next"], True)
    assert (told["first"], told["second"]) == (told["over"], told["again"])
    with meissner.connect(daemon.socket) as m:
        assert m.session_plays(told["next"])["plays"] == []


@pytest.mark.parametrize("example", ["first_play", "psychtoolbox"])
def test_an_example_runs(example: str, network: Network, tmp_path: Path) -> None:
    # Psychtoolbox is not installed: this stands for its clock.
    (tmp_path / "GetSecs.m").write_text("function seconds = GetSecs()\nseconds = time() - 1.7e9;\nend\n")
    lines = octave(f"addpath('{tmp_path}');\nrun('{MATLAB}/examples/{example}.m');\n", tmp_path, network).splitlines()
    if example == "first_play":
        assert re.fullmatch(r"onset [\d.]+ s, known to \d+ us", lines[0])
    else:
        for number, line in enumerate(lines, 1):
            found = re.fullmatch(
                rf"trial {number}: the edge began ([\d.]+) s after the flip, known to ([\d.]+) ms", line
            )
            assert found, line
            assert abs(float(found[1]) - 1.5) <= float(found[2]) / 1000 + 1e-4
    assert len(lines) == 2


def test_every_example_is_run_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    assert [file.stem for file in (MATLAB / "examples").glob("*.m") if f'"{file.stem}"' not in text] == []


def test_its_methods_have_the_names_of_python() -> None:
    source = (MATLAB / "Meissner.m").read_text(encoding="utf-8").split("methods (Access = private)")[0]
    here = set(re.findall(r"^    function (?:\w+ = )?(\w+)\(self", source, re.MULTILINE))
    # Methods of plays, sessions and instants there, and MATLAB's own.
    assert here - set(dir(meissner.Client)) == {"answer", "delete", "later", "session_end", "wait"}
