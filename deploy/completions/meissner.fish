# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_meissner_global_optspecs
    string join \n h/help V/version
end

function __fish_meissner_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_meissner_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_meissner_using_subcommand
    set -l cmd (__fish_meissner_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c meissner -n "__fish_meissner_needs_command" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_needs_command" -s V -l version -d 'Print version'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "demo" -d 'Daemon, simulated device and client in one process: plays a shipped edge and sums it up'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "daemon" -d 'Drive a device for the clients of a socket, until SIGTERM'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "play" -d 'Play a pattern, behind what is queued'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "stop" -d 'End the running play and clear the queue; stays armed'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "estop" -d 'All lines off at once, latched until `reset`'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "reset" -d 'Leave an emergency stop or fault: disarmed'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "arm" -d 'Take strokes from now on'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "disarm" -d 'Return pins, motors off'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "home" -d 'Move pins to where they ought to rest, between plays'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "calibrate" -d 'Measure what each motor really does: plays bursts for a minute, open loop, and stores the gains; motors must be armed'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "list" -d 'All patterns'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "show" -d 'A pattern: its motors, drives and warnings'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "import" -d 'Store a pattern file with the daemon, under the name in it'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "status" -d 'Show how everything stands'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "events" -d 'What happens, as it happens; with --json one document per line'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "receipt" -d 'What came of a play'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "motor" -d 'What a drive comes to in the steady state, by the motor model'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "simulate" -d 'What the skin\'s receptors make of a scene: spikes and rates'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "optimise" -d 'The pattern that makes a target felt'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "tradeoff" -d 'Time and error of every way to simulate a scene, measured on this machine; or what the streamer\'s lead is worth'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "report" -d 'Figures of the models and of patterns, as SVG and CSV, and a page that shows them'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "doctor" -d 'Look for what could keep this machine or its device from playing; exit 0 only if nothing does'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l seconds -d 'How long it plays' -r
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l open-loop -d 'No corrections from telemetry'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l config -d 'Configuration file (TOML)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l device -d 'auto, mock, pty, serial[:PATH|:SERIAL|:VID:PID[:SERIAL]] or usb[:SERIAL] [default: the configuration\'s, else auto]' -r
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l socket -d 'Where clients connect [default: the configuration\'s, else $MEISSNER_SOCKET, else $XDG_RUNTIME_DIR/meissner.sock, else /run/meissner/meissner.sock]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l check-config -d 'Only say whether the configuration is good; exit 1 if it is not'
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l seconds -d 'Cuts it, or repeats it if it has a duration' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l at -d 'A tick of the device\'s clock, or so many ms after the order' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l late -d 'What to do when strokes come late' -r -f -a "drop\t'Drop them whole and go on'
abort\t'End the play'"
complete -c meissner -n "__fish_meissner_using_subcommand play" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand play" -l replace -d 'Stop what runs and clear the queue first'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l open-loop -d 'No corrections from telemetry'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l wait -d 'Wait for its end and sum it up; exit 1 if not all was played. Ctrl-C ends the waiting (exit 130), not the play'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand play" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand stop" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand stop" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand stop" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand estop" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand estop" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand estop" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand reset" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand reset" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand reset" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l assume-rest -d 'Take every pin as being at rest: only after looking'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand home" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand home" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand home" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l motor -d 'Calibrate one motor, 0 to 23 [default: all]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l repetitions -d 'Play each number of pulses N times; with the default numbers each time takes half a minute [default: 2]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l pulses -d 'Play bursts of these numbers of pulses, 7 to 200, 3 s each [default: 14,28,42,56,70,84,98,112,126,140]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -s o -l out -d 'Also write the calibration to FILE' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand list" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand list" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand list" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand show" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand show" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand show" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand import" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand import" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand import" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand status" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand status" -l watch -d 'Again at every change'
complete -c meissner -n "__fish_meissner_using_subcommand status" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand status" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand events" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand events" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand events" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l frequency-hz -d 'Its frequency' -r
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l amplitude-um -d 'Its amplitude, peak to peak' -r
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand motor" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l method -d 'Method; a step, integrator or precision means stepped, else it is exact' -r -f -a "exact\t'From event to event, without a step'
stepped\t'By a fixed step'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l step-us -d 'The step [default: 200]' -r
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l integrator -d 'What is done in a step [default: propagator]' -r -f -a "euler\t'The paper\'s eq. 2: input and leak as they are at the step\'s start, a spike at its end'
propagator\t'The leak exactly, the input by its mean, crossings within the step'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l precision -d 'What it is computed with [default: f32]' -r -f -a "f32\t'Single precision'
f64\t'Double precision'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l max-rate-error -d 'Choose the cheapest method whose rates err by at most so many impulses/s, RMS over receptors' -r
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l rates-only -d 'Count spikes, and do not keep their times'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -s o -l out -d 'Where to write the pattern; its name is the file\'s [default: stdout]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l seed -d 'Of the search' -r
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l setting -d 'What may be chosen: motors may be off, 5 to 150 Hz; or always on, 5 to 300 Hz' -r -f -a "default\t'Motors may be off; 5 to 150 Hz'
always_on\t'The paper\'s: every motor vibrates; 5 to 300 Hz'"
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l budget -d 'About so many evaluations (for each frame of a moving target; or a list, N,N,...), or seconds in all (Ns) [default: until nothing improves]' -r
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l resume -d 'Begin with what a pattern file does, and improve on it' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l robust -d 'For the mean over eight populations of receptors in place of one'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l trace -d 'With --stream: stalls recorded on another machine, by the example `record_stalls`' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l plot -d 'Draw it into this file (SVG)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l stream -d 'Not a scene: the streamer\'s lead against late bursts, onsets and bytes, in virtual time under recorded stalls'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l loop -d 'Not a scene: the closed loop\'s rest errors and amplitudes against what is possible, over all settings (minutes)'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand report" -l out -d 'Where to write; made if it is not there' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand report" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand report" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l device -d 'Which device, as for `daemon`; without it, the daemon\'s, else the first board' -r
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l seconds -d 'How long wake-ups are measured, 0.1 to 3600: the longer, the rarer the stalls it sees' -r
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l socket -d 'The daemon\'s socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l json -d 'One JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "demo" -d 'Daemon, simulated device and client in one process: plays a shipped edge and sums it up'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "daemon" -d 'Drive a device for the clients of a socket, until SIGTERM'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "play" -d 'Play a pattern, behind what is queued'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "stop" -d 'End the running play and clear the queue; stays armed'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "estop" -d 'All lines off at once, latched until `reset`'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "reset" -d 'Leave an emergency stop or fault: disarmed'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "arm" -d 'Take strokes from now on'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "disarm" -d 'Return pins, motors off'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "home" -d 'Move pins to where they ought to rest, between plays'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "calibrate" -d 'Measure what each motor really does: plays bursts for a minute, open loop, and stores the gains; motors must be armed'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "list" -d 'All patterns'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "show" -d 'A pattern: its motors, drives and warnings'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "import" -d 'Store a pattern file with the daemon, under the name in it'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "status" -d 'Show how everything stands'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "events" -d 'What happens, as it happens; with --json one document per line'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "receipt" -d 'What came of a play'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "motor" -d 'What a drive comes to in the steady state, by the motor model'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "simulate" -d 'What the skin\'s receptors make of a scene: spikes and rates'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "optimise" -d 'The pattern that makes a target felt'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "tradeoff" -d 'Time and error of every way to simulate a scene, measured on this machine; or what the streamer\'s lead is worth'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "report" -d 'Figures of the models and of patterns, as SVG and CSV, and a page that shows them'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "doctor" -d 'Look for what could keep this machine or its device from playing; exit 0 only if nothing does'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play stop estop reset arm disarm home calibrate list show import status events receipt motor simulate optimise tradeoff report doctor help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
