#!/bin/bash
# Runs in the guest, as root, with systemd and udev up; prints a line per step: ok, WRONG (then goes on) or FAIL (then exits).
# `run` starts it and checks that every line is there.
set -uo pipefail
cd /usb || exit
export PATH=/usb:$PATH LC_ALL=C
serial=E6614C0001
port=/dev/serial/by-id/usb-meissner_meissner_$serial-if00

way=all daemon='' board=''
ok() { printf 'ok    %-5s %s\n' "$way" "$*"; }
wrong() { printf 'WRONG %-5s %s\n' "$way" "$*"; }
fail() {
    printf 'FAIL  %-5s %s\n' "$way" "$*"
    for log in daemon second board; do
        [ ! -s $log.log ] || { echo "-- $log"; tail -n 25 $log.log; }
    done
    echo '-- kernel'
    dmesg | tail -n 15
    exit 1
}
now() { date +%s.%N; }
ms() { awk -v from="$1" -v to="$2" 'BEGIN { printf "%.1f ms", (to - from) * 1000 }'; }
# within SECONDS COMMAND...: until it succeeds
within() {
    local end=$((SECONDS + $1))
    shift
    until "$@" >/dev/null 2>&1; do
        [ $SECONDS -lt $end ] || return 1
        sleep 0.05
    done
}
# ms of processor time a process has used
used_ms() { awk '{ print ($14 + $15) * 10 }' "/proc/$1/stat"; }

export MEISSNER_SOCKET=/run/m.sock
json() { meissner "$1" --json | jq -er "$2"; }
has_device() { json status .device >/dev/null && ! state_is no-device; }
state_is() { [ "$(json status .state)" = "$1" ]; }
said() { grep -e "$1" daemon.log | tail -n 1 | cut -d' ' -f2- | sed 's/^ *//'; }
# The time of the daemon's last log line with these words, s; nothing if there is none
logged() {
    local line
    line=$(grep -e "$1" daemon.log | tail -n 1) && date -d "${line%%Z*}Z" +%s.%N
}

attach() {
    usbip attach -r 127.0.0.1 -b 0-0-0 >usbip.log 2>&1 || fail "usbip attach: $(tail -n 1 usbip.log)"
    within 10 test -e $port || fail "no $port"
    udevadm settle --timeout 10
}
detach() { usbip detach -p 0 >usbip.log 2>&1 || fail "usbip detach: $(tail -n 1 usbip.log)"; }

# The last play's state and burst counts, which must add up
accounts() {
    json receipt '.counts.bursts as $b | select($b.planned > 0 and $b.planned == $b.played + $b.late + $b.dropped + $b.refused + $b.replaced)
        | "\(.state), \($b.planned) bursts: \($b.played) played, \($b.late) late, \($b.dropped) dropped, \($b.refused) refused"'
}
arm() { state_is armed || meissner arm --assume-rest --checked usb-test >out.log 2>&1 || fail "$1: arm: $(cat out.log)"; }
# Arms and plays. Tries once more if a stall of the machine aborted the play, or made the line seem too slow for it
less=()
play() {
    local code sum try
    for try in 1 2 3; do
        arm "$1"
        code=0
        meissner play edge-45-paper --seconds 2 --wait "${less[@]}" >out.log 2>&1 || code=$?
        if grep -q 'the line carries' out.log; then
            echo "      once more, open loop: $(<out.log)"
            less=(--open-loop)
            continue
        fi
        sum=$(accounts) || fail "$1: accounts are not closed: $(json receipt .counts.bursts)"
        [[ $sum != done,* ]] || break
        [ $try -lt 3 ] || fail "$1: $sum ($(json receipt .cause)), exit $code: $(tail -n 1 out.log)"
        echo "      once more: $sum ($(json receipt .cause))"
        within 20 has_device
    done
    ok "$1: $sum, exit $code; onset after $(json receipt .onset.latency_ms) ms"
}

# Resets of the bus in the middle of a play, beside control transfers that they cut. The daemon has the board again by itself
resets() {
    local try reader sum
    arm reset
    meissner play edge-45-paper --seconds 20 --open-loop >out.log 2>&1 || fail "reset: $(cat out.log)"
    while :; do lsusb -v -d 1209:0001; done >/dev/null 2>&1 &
    reader=$!
    for try in 1 2 3 4 5; do
        sleep 0.$((try * 37 % 10))7
        usbreset 1209:0001 >reset.log 2>&1 || fail "reset $try: $(tail -n 1 reset.log)"
    done
    kill $reader
    wait $reader
    within 20 test -e $port || fail "reset: no $port"
    udevadm settle --timeout 10
    within 20 state_is disarmed || fail "reset: $(meissner status | head -n 1)"
    sum=$(accounts) || fail "reset: accounts are not closed: $(json receipt .counts.bursts)"
    [[ $sum != done,* ]] || fail "reset: the play went on: $sum"
    ok "reset: 5 resets; the play was $sum; $(json receipt .cause)"
    play 'after the resets'
}

# Cables unplugged at some moment of the enumeration
cuts() {
    local try
    detach
    for try in 1 2 3 4 5 6 7 8; do
        # The driver takes a moment to free its port.
        within 5 usbip attach -r 127.0.0.1 -b 0-0-0 || fail "cut $try: usbip attaches nothing"
        sleep 0.$((try * 53 % 40 + 10))
        within 5 usbip detach -p 0 || fail "cut $try: usbip detaches nothing"
    done
    sleep 2
    attach
    within 20 state_is disarmed || fail "cut: $(meissner status | head -n 1)"
    play 'cut: after 8 enumerations that were cut'
}

# Everything once, through one of the board's interfaces
over() {
    way=$1
    less=()
    local device=$2 boot before line from cut to
    echo "== $device"

    # As a user who may only use boards. Its findings about the machine do not matter here.
    setpriv --reuid nobody --regid nogroup --groups haptics meissner doctor --device "$device" >out.log 2>&1
    line=$(grep 'round trip' out.log) || fail "doctor: $(tail -n 3 out.log)"
    ok "doctor: ${line#*round trip }"
    grep -E '(device|line|drift) ' out.log | sed 's/^/      /'

    from=$(now)
    meissner daemon --config meissner.toml --device "$device" 2>daemon.log &
    daemon=$!
    within 20 state_is disarmed || fail "connect: $(meissner status 2>&1 | head -n 1)"
    ok "connect: $(json status .device.kind) after $(ms "$from" "$(logged 'device connected')")"
    boot=$(json status .device.boot)
    meissner status | sed 's/^/      /'

    before=$(used_ms $board)
    sleep 2
    ok "idle: the board used $(($(used_ms $board) - before)) ms of processor time in 2 s"
    [ $(($(used_ms $board) - before)) -le 400 ] || fail "idle: the board is busy"

    play 'play'

    timeout 5 meissner daemon --config meissner.toml --device "$device" --socket /run/n.sock 2>second.log
    line=$(grep -E 'in use|another' second.log) || fail "second: $(tail -n 1 second.log)"
    [ "$(wc -l <<<"$line")" = 1 ] || fail "second: said more than once"
    ok "second: $(cut -d' ' -f2- <<<"$line" | sed 's/^ *//')"
    within 20 has_device || fail "second: it disturbed the first: $(json status .state)"

    arm unplug
    meissner play edge-45-paper --seconds 20 --open-loop >out.log 2>&1 || fail "unplug: $(cat out.log)"
    sleep 1.5
    from=$(now)
    echo 'meissner: now' >/dev/kmsg
    detach
    within 5 logged 'device disconnected' || fail "unplug: the daemon did not say so"
    to=$(logged 'device disconnected')
    # When the kernel released the board, by its own clock. Before that, usbip started and closed the connection.
    cut=$(dmesg | awk -F '[][]' -v from="$from" '/meissner: now/ { now = $2 } /USB disconnect/ { cut = $2 }
        END { printf "%.6f", from + cut - now }')
    ok "unplug: said $(ms "$cut" "$to") after the kernel ($(ms "$from" "$to") after usbip was told): $(said 'device disconnected')"
    line=$(accounts) || fail "ended: accounts are not closed: $(json receipt .counts.bursts)"
    [[ $line == stopped,* ]] || fail "ended: play $line"
    ok "ended: $line; $(json receipt .cause)"
    if within 5 state_is no-device; then
        ok "gone: status says $(meissner status | head -n 1 | tr -s ' ')"
    else
        wrong "gone: 5 s after the unplug status says $(json status '"\(.state), device \(.device)"')"
    fi
    sleep 2
    kill -0 $daemon || fail "unplug: the daemon has ended"

    from=$(now)
    attach
    within 20 state_is disarmed || fail "replug: $(meissner status | head -n 1)"
    [ "$(json status .device.boot)" != "$boot" ] || fail "replug: the board has the same boot id"
    ok "replug: $(json status .device.kind) after $(ms "$from" "$(logged 'device connected')"), disarmed"
    play 'again'
    resets
    cuts

    kill $daemon
    wait $daemon || fail "end: the daemon ended with $?"
    [ ! -e $MEISSNER_SOCKET ] || fail "end: the socket is still there"
    ok "end: $(said ending)"
}


echo
ok "guest: Debian $(cat /etc/debian_version), Linux $(uname -r), $(nproc) processors"
modprobe -a vhci_hcd cdc_acm || fail "no modules"
systemd-sysusers ./meissner.sysusers || fail "no users"
cp 70-meissner.rules /etc/udev/rules.d/ || fail "no udev rule"
udevadm control --reload
virtual-board $serial >board.log 2>&1 &
board=$!
within 5 grep -q 'plugged in at' board.log || fail "the board does not start"
attach
lsusb -d 1209:0001 >out.log || fail "lsusb: no 1209:0001"
strings=$(cd /sys/bus/usb/devices/1-1 && cat manufacturer product serial | paste -sd' ')
[ "$strings" = "meissner meissner $serial" ] || fail "lsusb: strings are $strings"
ok "lsusb: $(<out.log); strings $strings"
lsusb -v -d 1209:0001 2>/dev/null | awk '/bInterfaceClass/ { $1 = $2 = ""; printf "\n     %s:", $0 }
    /bEndpointAddress/ { printf " %s %s", $4, $5 } /wMaxPacketSize/ { printf " %s bytes", $4 } END { print "" }' | sed 1d
for name in $port /dev/meissner-$serial; do
    [ "$(readlink -f "$name")" = /dev/ttyACM0 ] || fail "tty: no $name"
done
ok "tty: $port, /dev/meissner-$serial: $(stat -c '%n %A %U %G' /dev/ttyACM0 /dev/bus/usb/001/002 | paste -sd,)"

over path "serial:$port"
over id serial:1209:0001
over usb usb

way=all
detach
within 5 grep -q unplugged board.log
kill $board
wait $board || fail "the board ended with $?"
within 5 modprobe -r cdc_acm vhci_hcd || fail "the kernel still holds the board"
left=$(pgrep -l 'meissner|virtual-') && fail "left running: $left"
ok "left: no process, no port; $(grep -c 'plugged in, boot' board.log) boots of the board"
echo 'DONE'
