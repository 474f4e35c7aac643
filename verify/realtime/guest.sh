#!/bin/bash
# Runs in the guest, as root; prints a line per step: ok, WRONG (then goes on) or FAIL (then exits). `run` starts it, cuts its
# power while it prints what was acknowledged, boots it again, and checks that every line is there.
# shellcheck disable=SC2015 # `fail` ends it: A && B || fail is what is meant
set -uo pipefail
mkdir -p /tmp/out && cd /tmp/out || exit
export LC_ALL=C PATH=/usr/bin:/usr/sbin:/bin:/sbin
unset MEISSNER_SOCKET XDG_RUNTIME_DIR

part=rt
ok() { printf 'ok    %-5s %s\n' "$part" "$*"; }
wrong() { printf 'WRONG %-5s %s\n' "$part" "$*"; }
fail() {
    printf 'FAIL  %-5s %s\n' "$part" "$*"
    echo '-- journal'
    journalctl -u meissner.service -o cat -n 25 --no-pager 2>/dev/null
    [ ! -s out.log ] || { echo '-- output'; tail -n 15 out.log; }
    exit 1
}
# within SECONDS COMMAND...: until it succeeds
within() {
    local end=$((SECONDS + $1))
    shift
    until "$@" >/dev/null 2>&1; do
        [ $SECONDS -lt $end ] || return 1
        sleep 0.1
    done
}
uptime_s() { cut -d' ' -f1 /proc/uptime; }
json() { meissner "$1" --json | jq -er "$2"; }
state_is() { [ "$(json status .state)" = "$1" ]; }
unit() { systemctl show -P "$1" meissner.service; }
# shellcheck disable=SC2016 # jq's variable
accounts() {
    json receipt '.counts.bursts as $b | select($b.planned > 0 and $b.planned == $b.played + $b.late + $b.dropped + $b.refused)
        | "\(.state), \($b.planned) bursts: \($b.played) played, \($b.late) late, \($b.dropped) dropped, \($b.refused) refused"'
}
arm() { state_is armed || { within 20 state_is disarmed && meissner arm --assume-rest >out.log 2>&1; } || fail "$1: arm: $(cat out.log)"; }
book() { cat /var/lib/meissner/logbook/*.jsonl; }
installed() {
    dpkg -i /test/meissner.deb >out.log 2>&1 || fail "$1: dpkg: $(tail -n 1 out.log)"
    # An emulated processor stalls for longer than a real one.
    sed -i 's/^lead_ms = .*/lead_ms = 1000/; s/^lease_ms = .*/lease_ms = 10000/' /etc/meissner/meissner.toml
}
disk() {
    modprobe -a virtio_pci virtio_blk ext4 || fail "disk: no modules"
    within 10 test -b /dev/vda || fail "disk: no /dev/vda"
}

first() {
    ok "guest: Debian $(cat /etc/debian_version), Linux $(uname -r), $(nproc) processors"
    installed guest
    systemctl restart meissner.service || fail "guest: start"
    within 20 state_is disarmed || fail "guest: $(meissner status 2>&1 | head -n 1)"
    local pid tid policy status
    pid=$(unit MainPID)
    arm policy
    tid=$(grep -lx streamer "/proc/$pid/task/"*/comm | cut -d/ -f5)
    policy=$(chrt -p "$tid" | sed 's/^pid [0-9]*.s //' | paste -sd,)
    [[ $policy == *SCHED_FIFO* ]] || fail "policy: $policy"
    ok "policy: thread streamer: $policy"
    status=/proc/$pid/status
    [ "$(awk '/^VmLck/ { print ($2 > 1000) }' "$status")" = 1 ] || fail "memory: $(grep VmLck "$status")"
    ok "memory: $(grep -E '^(VmLck|VmRSS)' "$status" | tr -s '\t ' ' ' | paste -sd,)"
    [ "$(awk '/^Cap(Prm|Eff|Bnd|Amb)/ && $2 !~ /^0+$/' "$status")" = '' ] || fail "capabilities: $(grep ^Cap "$status")"
    [ "$(ps -o user= -p "$pid")" = meissner ] || fail "capabilities: runs as $(ps -o user= -p "$pid")"
    ok "capabilities: user $(ps -o user=,group= -p "$pid" | tr -s ' '), $(grep -E '^(CapEff|CapBnd|NoNewPrivs|Seccomp):' "$status" | tr -s '\t ' ' ' | paste -sd,)"
    local sum try
    for try in 1 2 3; do
        arm play
        meissner play edge-45-paper --seconds 2 --wait >out.log 2>&1
        sum=$(accounts) || fail "play: burst counts do not add up: $(json receipt .counts.bursts)"
        [[ $sum != done,* ]] || break
        [ $try -lt 3 ] || fail "play: $sum ($(json receipt .cause))"
    done
    ok "play: $sum"

    part=clock
    local restarts lines id hour
    restarts=$(unit NRestarts)
    lines=$(book | wc -l)
    for try in 1 2 3; do
        arm play
        meissner play edge-45-paper --seconds 6 --wait >out.log 2>&1 &
        sleep 2
        hour=$(date +%H:%M:%S)
        date -s "@$(($(date +%s) - 3600))" >/dev/null || fail "play: the clock cannot be set"
        wait $!
        sum=$(accounts) || fail "play: burst counts do not add up: $(json receipt .counts.bursts)"
        [[ $sum != done,* ]] || break
        [ $try -lt 3 ] || fail "play: $sum ($(json receipt .cause))"
    done
    ok "play: from $hour to $(date +%H:%M:%S) in its middle; $sum"
    [ "$(unit MainPID) $(unit NRestarts)" = "$pid $restarts" ] || fail "daemon: restarted"
    sleep 12
    [ "$(unit MainPID) $(unit NRestarts)" = "$pid $restarts" ] || fail "daemon: restarted by its watchdog"
    meissner status >/dev/null || fail "daemon: no answer"
    ok "daemon: the same process, 12 s later"
    id=$(json receipt .id)
    book | jq -es 'map(.monotonic_ns) | . == sort' >/dev/null || fail "logbook: lines are out of order or do not parse"
    book | jq -es --argjson id "$id" 'map(select(.event == "ended" and .receipt.id == $id)) | length == 1' >/dev/null ||
        fail "logbook: play $id is not there once"
    ok "logbook: $(($(book | wc -l) - lines)) more lines, in the order of the monotonic clock; files $(cd /var/lib/meissner/logbook && echo *)"
    journalctl -u meissner.service -o json --no-pager | jq -es --arg id "$id" 'map(select(.MESSAGE | type == "string" and startswith("play \($id) "))) | length > 0' >/dev/null ||
        fail "journal: play $id is not there"
    ok "journal: $(journalctl -u meissner.service -o cat --no-pager -n 1)"

    part="cut"
    disk
    meissner disarm >/dev/null
    systemctl stop meissner.service meissner.socket 2>/dev/null
    mkfs.ext4 -q /dev/vda && mount /dev/vda /var/lib/meissner || fail "disk: no file system"
    systemctl start meissner.socket meissner.service || fail "disk: start"
    local n=0
    arm disk
    # Acknowledged files must survive. `run` reads these lines and cuts the power.
    while [ $n -lt 1000 ]; do
        n=$((n + 1))
        sed "s/^name = .*/name = \"site-$n\"/" /usr/share/meissner/patterns/pin-60.toml >pattern.toml
        meissner import pattern.toml >out.log 2>&1 || fail "cut: import: $(cat out.log)"
        echo "kept upload $n $(uptime_s)"
        state_is armed || arm cut
        meissner play edge-45-paper --seconds 0.3 --wait >out.log 2>&1
        echo "kept play $(json receipt .id) $(uptime_s)"
    done
    fail "cut: the power was not cut"
}

second() {
    local last what n at lost=0 acked=0 missing='' plays
    part="cut"
    # Read before the daemon starts, which would repair the files.
    installed disk
    systemctl stop meissner.service meissner.socket
    disk
    mount /dev/vda /mnt 2>out.log || fail "disk: $(cat out.log)"
    ok "disk: mounted; $(dmesg | grep -m 1 -o 'EXT4-fs (vda): .*recovery complete' || echo 'no recovery needed')"
    last=$(tail -n 1 /test/kept.txt | cut -d' ' -f4)
    while read -r _ what n at; do
        [ "$what" = upload ] || continue
        acked=$((acked + 1))
        # A pattern that is there must be whole.
        if [ -e "/mnt/patterns/site-$n.toml" ]; then
            cmp -s <(sed "s/^name = .*/name = \"site-$n\"/" /usr/share/meissner/patterns/pin-60.toml) "/mnt/patterns/site-$n.toml" ||
                fail "uploads: site-$n is not what was sent"
        else
            lost=$((lost + 1)) missing="$missing site-$n ($(awk -v at="$at" -v last="$last" 'BEGIN { printf "%.1f s before the last", last - at }'))"
            awk -v at="$at" -v last="$last" 'BEGIN { exit last - at <= 1 }' && fail "uploads: site-$n is missing, $at of $last s"
        fi
    done </test/kept.txt
    ok "uploads: $acked answered, $lost missing$missing"
    plays=$(awk -v last="$last" '$2 == "play" && last - $4 > 1 { print $3 }' /test/kept.txt)
    cat /mnt/logbook/*.jsonl >book.jsonl || fail "logbook: no file"
    # The last line may be torn: the daemon repairs that when it starts.
    head -c "$(($(wc -c <book.jsonl) - $(tail -n 1 book.jsonl | wc -c)))" book.jsonl | jq -es length >/dev/null || fail "logbook: lines do not parse"
    for n in $plays; do
        grep -q '"event":"ended".*"id":'"$n"'[,}]' book.jsonl || fail "logbook: play $n is missing, which had ended more than a second before"
    done
    ok "logbook: $(wc -l <book.jsonl) lines; $(grep -c '^kept play' /test/kept.txt) plays were answered, $(grep -c '"event":"ended"' book.jsonl) are in it, all but those of the last second"
    umount /mnt
    mount /dev/vda /var/lib/meissner || fail "starts: mount"
    systemctl start meissner.socket meissner.service
    within 20 state_is disarmed || fail "starts: $(meissner status 2>&1 | head -n 1)"
    meissner list >out.log 2>&1 && grep -q site-1 out.log || fail "starts: the site's patterns are not listed"
    book | jq -es length >/dev/null || fail "starts: the logbook does not parse"
    ok "starts: $(grep -c site- out.log) patterns of the site; $(book | wc -l) lines, all of which parse"
}

"$(cat /test/mode)"
echo 'DONE'
