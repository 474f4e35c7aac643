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
complete -c meissner -n "__fish_meissner_needs_command" -f -a "demo" -d 'Play a shipped edge on a simulated array and print a summary: daemon, device and client in one process'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "daemon" -d 'Drive a device for the clients of a socket, until SIGTERM'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "play" -d 'Play a pattern after the queued ones'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "sequence" -d 'Play a sequence of patterns with exact times, as one play'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "live" -d 'Play a stimulus that follows a mouse, a knob, a touchpad or the lines of stdin, until its source ends or Ctrl-C'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "stop" -d 'End the running play and clear the queue; the motors stay armed'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "estop" -d 'Turn all lines off at once; they stay off until `reset`'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "reset" -d 'Leave an emergency stop or a fault; the motors are disarmed'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "arm" -d 'Enable the motors'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "disarm" -d 'Return the pins and switch the motors off'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "home" -d 'Move the pins to their rest position, between plays'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "calibrate" -d 'Measure the gains of the motors and store them: by telemetry, in a minute of bursts, or with a laser (--plan, then --from)'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "list" -d 'List all patterns'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "show" -d 'Show the motors, drives and warnings of a pattern'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "import" -d 'Store a pattern file with the daemon, under the name in it'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "remove" -d 'Remove a pattern from the daemon\'s pattern directory'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "status" -d 'Show the state of the daemon, its device and its queue'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "events" -d 'Print events as they happen; with --json one document per line'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "receipt" -d 'Show the result of a play'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "session" -d 'Start, end, show, export and replay sessions: plays of one participant that are recorded together'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "token" -d 'Create, list and revoke access tokens of clients that come over the network'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "motor" -d 'Compute the steady state of a drive by the motor model, and its daily exposure'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "displacement" -d 'Sample how far a pattern moves each pin, by the motor model, as CSV'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "simulate" -d 'Simulate afferent spikes for a scene'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "optimise" -d 'Find a pattern for a target shape'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "tradeoff" -d 'Compare simulation methods on this machine, leads of the streamer, or position control'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "discriminate" -d 'Predict whether a finger can tell patterns apart: d\', per cent correct, confusion matrix'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "sweep" -d 'Run a plan of thousands of searches, simulations or comparisons, here or on a cluster'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "validate" -d 'Compare both models of skin and afferents with published figures'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "report" -d 'Draw figures of the models and of patterns, as SVG and CSV, and a page that shows them'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "doctor" -d 'Check what could keep this machine or its device from playing; exit 0 only if nothing does'
complete -c meissner -n "__fish_meissner_needs_command" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l seconds -d 'Play for S seconds' -r
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l open-loop -d 'Play without corrections from telemetry'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l sensorless -d 'Simulate an array without telemetry that has a lower stop, as a board may'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand demo" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l config -d 'Read the configuration from file F (TOML)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l device -d 'Use this device: auto, mock, pty, serial[:PATH|:SERIAL|:VID:PID[:SERIAL]] or usb[:SERIAL] [default: the configuration\'s, else auto]' -r
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l socket -d 'Listen for clients at PATH [default: the configuration\'s, else $MEISSNER_SOCKET, else $XDG_RUNTIME_DIR/meissner.sock, else /run/meissner/meissner.sock]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l listen -d 'Serve the API over TCP, too, at ADDRESS, as 127.0.0.1:8765 [default: the configuration\'s, else not]' -r
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l check-config -d 'Check the configuration and end; exit 1 if it is not valid'
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -l no-record -d 'Keep no session record'
complete -c meissner -n "__fish_meissner_using_subcommand daemon" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l seconds -d 'Play for S seconds: truncate or loop the pattern' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l at -d 'Begin at TICK of the device\'s clock, MS milliseconds after the request, or at NS nanoseconds of CLOCK_MONOTONIC' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l fit -d 'Choose which strokes are played at the end' -r -f -a "whole\t'Those that have ended by then: a little shorter than asked for'
cover\t'Those that begin before: a little longer'"
complete -c meissner -n "__fish_meissner_using_subcommand play" -l late -d 'Choose what happens to late strokes' -r -f -a "drop\t'Drop them whole and go on'
abort\t'End the play'"
complete -c meissner -n "__fish_meissner_using_subcommand play" -l session -d 'Refuse the play unless the session with this id runs [default: the session that this terminal has started]' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l trial -d 'Record the play as trial N' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l label -d 'Record the play with a label; up to 16 of them' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l scale -d 'Multiply the amplitude of every drive by X, 0 to 1' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l code -d 'Give the code N, 1 to 255, on the trigger output instead of one pulse' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l trigger-ms -d 'Make the trigger\'s pulse, or each of a code\'s ten cells, MS milliseconds wide' -r
complete -c meissner -n "__fish_meissner_using_subcommand play" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand play" -l endless -d 'Allow a play without end, until `meissner stop` or a participant\'s limit'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l replace -d 'Stop the running play and clear the queue first'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l open-loop -d 'Play without corrections from telemetry'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l no-trigger -d 'Give nothing on the trigger output'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l wait -d 'Wait for the end and print the receipt; exit 1 if not all was played. Ctrl-C, SIGTERM and SIGHUP stop the play (exit 130, 143, 129)'
complete -c meissner -n "__fish_meissner_using_subcommand play" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand play" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -l at -d 'Begin at TICK of the device\'s clock, MS milliseconds after the request, or at NS nanoseconds of CLOCK_MONOTONIC' -r
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -l replace -d 'Stop the running play and clear the queue first'
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -l wait -d 'Wait for the end and print the receipt; exit 1 if not all was played. Ctrl-C, SIGTERM and SIGHUP stop the sequence (exit 130, 143, 129)'
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand sequence" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand live" -l follow -d 'Follow this source: stdin (a line: X_MM Y_MM [DEGREES], or a JSON object), mouse (the first one), or an input device' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l mm-per-count -d 'Shift the shape by X mm for each count of a mouse' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l updates-hz -d 'Send at most F updates a second, each the newest state of the source; lines of a file are sent one by one [default: 50]' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l timeout-ms -d 'End the play when the daemon hears nothing for MS milliseconds [default: 500]' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l max-frequency-hz -d 'Allow frequencies up to F Hz [default: the highest of the first line, at least 60; with TARGET that of --setting]' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l budget-ms -d 'Search for the drives of a pose for MS milliseconds [default: 15]' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l objective -d 'Choose what the drives of a pose maximise: ON afferents lie within reach of the target, OFF are all others' -r -f -a "contrast\t'Mean rate of ON minus mean rate of OFF, as in the paper'
off-rms\t'Mean of ON minus RMS of OFF: keeps dots apart, with `optimise --robust`'
off-rms-twice\t'Mean of ON minus twice the RMS of OFF: stricter'
near-off\t'As contrast; OFF afferents near the target weigh more'
auc\t'Chance that an ON afferent fires faster than an OFF one'
correlation\t'Correlation of the rates with the ON set'
rivals\t'Distance from the most similar shape, in SD of the counts'"
complete -c meissner -n "__fish_meissner_using_subcommand live" -l model -d 'Choose the models whose RA afferents are ON or OFF' -r -f -a "both\t'The gain over the rule naive-reach, under the model in which it is less'
membrane\t'RA afferents with a leaky membrane, as in the paper'
afferents\t'Skin mechanics, and RA afferents fitted to recordings'"
complete -c meissner -n "__fish_meissner_using_subcommand live" -l setting -d 'Choose the search space' -r -f -a "default\t'Motors may be off; 40 to 150 Hz'
always_on\t'All motors vibrate; 40 to 300 Hz'"
complete -c meissner -n "__fish_meissner_using_subcommand live" -l late -d 'Choose what happens to late strokes' -r -f -a "drop\t'Drop them whole and go on'
abort\t'End the play'"
complete -c meissner -n "__fish_meissner_using_subcommand live" -l session -d 'Refuse the play unless the session with this id runs [default: the session that this terminal has started]' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l trial -d 'Record the play as trial N' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l label -d 'Record the play with a label; up to 16 of them' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l scale -d 'Multiply the amplitude of every drive by X, 0 to 1' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l code -d 'Give the code N, 1 to 255, on the trigger output instead of one pulse' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l trigger-ms -d 'Make the trigger\'s pulse, or each of a code\'s ten cells, MS milliseconds wide' -r
complete -c meissner -n "__fish_meissner_using_subcommand live" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand live" -l keep-alive -d 'Go on while stdin is silent. Without it only a line of a pipe or terminal shows that the source works'
complete -c meissner -n "__fish_meissner_using_subcommand live" -l replace -d 'Stop the running play and clear the queue first'
complete -c meissner -n "__fish_meissner_using_subcommand live" -l open-loop -d 'Play without corrections from telemetry'
complete -c meissner -n "__fish_meissner_using_subcommand live" -l no-trigger -d 'Give nothing on the trigger output'
complete -c meissner -n "__fish_meissner_using_subcommand live" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand live" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand stop" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand stop" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand stop" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand estop" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand estop" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand estop" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand reset" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand reset" -l force -d 'Reset although another terminal has ordered an emergency stop since the last reset'
complete -c meissner -n "__fish_meissner_using_subcommand reset" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand reset" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l checked -d 'Say who has looked at the pins and found them level: needed after they may have drifted; on a terminal the command asks' -r
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l silence -d 'Disarm after S seconds in which neither the program that armed nor the last one that moved pins has sent anything, 1 to 86400 [default: `armed_silence_s` of the daemon\'s configuration]' -r
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l assume-rest -d 'State that all pins are at rest: look at them first'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l unattended -d 'Let the motors stay armed however long nobody asks the daemon'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand arm" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand disarm" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand home" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand home" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand home" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l motor -d 'Calibrate one motor, 0 to 23 [default: all]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l repetitions -d 'Play each number of pulses N times; with the default numbers each time takes half a minute [default: 2]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l pulses -d 'Play bursts of these numbers of pulses, 7 to 200, 3 s each [default: 14,28,42,56,70,84,98,112,126,140]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -s o -l out -d 'Write the calibration to FILE, too; with --from, add it to FILE and do not ask a daemon' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l plan -d 'For a laser, without telemetry: play the bursts of --motor and write them with their ticks to PLAN; with --from, read them from PLAN [default: calibration-plan.json]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l from -d 'Fit the motor of the plan to a laser\'s recording: a CSV file of time and displacement, by any clock' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l time-unit -d 'Read the recording\'s time in this unit: s, ms or us [default: the header\'s, else s]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l displacement-unit -d 'Read the recording\'s displacement in this unit: m, mm, um or nm [default: the header\'s, else um]' -r
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l plot -d 'Draw the recording, the fit and the residuals to FILE (SVG)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand calibrate" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand list" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand list" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand list" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand show" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand show" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand show" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand import" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand import" -l replace -d 'Replace a stored pattern of that name'
complete -c meissner -n "__fish_meissner_using_subcommand import" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand import" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand remove" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand remove" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand remove" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand status" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand status" -l watch -d 'Show it again at every change'
complete -c meissner -n "__fish_meissner_using_subcommand status" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand status" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand events" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand events" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand events" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand receipt" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "start" -d 'Start a session; plays belong to it until it ends'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "end" -d 'End the running session'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "leave" -d 'Forget the session that this terminal has started; it goes on, and other commands of this terminal do not belong to it'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "list" -d 'List the recorded sessions, the oldest first'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "export" -d 'Export the recorded plays of a session as CSV, one row per stimulus; with --json as one document; exit 1 if the record does not have the session whole'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "replay" -d 'Play a recorded session again with the same gaps, and compare the receipts; exit 1 if something differs'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "show" -d 'Show a session'
complete -c meissner -n "__fish_meissner_using_subcommand session; and not __fish_seen_subcommand_from start end leave list export replay show help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l participant -d 'Name the participant by this pseudonym' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l experiment -d 'Name the experiment' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l label -d 'Record a label; up to 16 of them' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l seed -d 'Record the seed of the experiment\'s random numbers' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l exclusive -d 'Let others only read, stop, disarm and order emergency stops'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from start" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from end" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from end" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from end" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from leave" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from list" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from list" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from list" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from export" -s o -l output -d 'Write to FILE [default: stdout]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from export" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from export" -l incomplete -d 'Export what there is of a session that the record does not have whole'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from export" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from export" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l from -d 'Begin with this play, by its number in the export' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l to -d 'End with this play' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l play -d 'Play this one alone' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l rest-tolerance-um -d 'Report a rest error as different if it is more than UM um larger than the recorded one' -r
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l dry-run -d 'Print what would be played, and play nothing'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from replay" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from show" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from show" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from show" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "start" -d 'Start a session; plays belong to it until it ends'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "end" -d 'End the running session'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "leave" -d 'Forget the session that this terminal has started; it goes on, and other commands of this terminal do not belong to it'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "list" -d 'List the recorded sessions, the oldest first'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "export" -d 'Export the recorded plays of a session as CSV, one row per stimulus; with --json as one document; exit 1 if the record does not have the session whole'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "replay" -d 'Play a recorded session again with the same gaps, and compare the receipts; exit 1 if something differs'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "show" -d 'Show a session'
complete -c meissner -n "__fish_meissner_using_subcommand session; and __fish_seen_subcommand_from help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand token; and not __fish_seen_subcommand_from create list revoke help" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand token; and not __fish_seen_subcommand_from create list revoke help" -f -a "create" -d 'Create an access token and print it: the only time that it is shown'
complete -c meissner -n "__fish_meissner_using_subcommand token; and not __fish_seen_subcommand_from create list revoke help" -f -a "list" -d 'List the access tokens, without their secrets'
complete -c meissner -n "__fish_meissner_using_subcommand token; and not __fish_seen_subcommand_from create list revoke help" -f -a "revoke" -d 'Revoke an access token; it is not valid from the next request on'
complete -c meissner -n "__fish_meissner_using_subcommand token; and not __fish_seen_subcommand_from create list revoke help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from create" -l role -d 'Let a client with the token read (observe) or do everything (operate)' -r -f -a "observe\t''
operate\t''"
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from create" -l name -d 'Name who or what uses the token' -r
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from create" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from create" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from create" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from list" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from list" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from list" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from revoke" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from revoke" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from revoke" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from help" -f -a "create" -d 'Create an access token and print it: the only time that it is shown'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from help" -f -a "list" -d 'List the access tokens, without their secrets'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from help" -f -a "revoke" -d 'Revoke an access token; it is not valid from the next request on'
complete -c meissner -n "__fish_meissner_using_subcommand token; and __fish_seen_subcommand_from help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l frequency-hz -d 'Drive with F Hz' -r
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l amplitude-um -d 'Drive with A um, peak to peak' -r
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l hours -d 'Compute the daily exposure of H hours, 0 to 24' -r
complete -c meissner -n "__fish_meissner_using_subcommand motor" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand motor" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l seconds -d 'Play for S seconds: truncate or loop the pattern' -r
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l fit -d 'Choose which strokes are played at the end' -r -f -a "whole\t'Those that have ended by then: a little shorter than asked for'
cover\t'Those that begin before: a little longer'"
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l scale -d 'Multiply the amplitude of every drive by X, 0 to 1' -r
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l rate-hz -d 'Take F samples a second, 1 to 85000' -r
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l first-s -d 'Take the first sample S seconds after the onset' -r
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand displacement" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l model -d 'Choose the model of skin and afferents [default: the scene\'s key `model`, else membrane]' -r -f -a "membrane\t'RA afferents with a leaky membrane, Gaussian receptive fields'
afferents\t'Skin under flat pins, and SA1, RA and PC afferents fitted to recordings; steps of 200 us'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l method -d 'Choose the method [default: stepped if a step, integrator or precision is given, else exact]' -r -f -a "exact\t'Go from event to event, without a step'
stepped\t'Go by a fixed step'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l step-us -d 'Take steps of N us [default: 200]' -r
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l integrator -d 'Choose how a step is integrated [default: propagator]' -r -f -a "euler\t'Use eq. 2 of the paper: input and leak at the step\'s start, a spike at its end'
propagator\t'Use the exact leak, the mean input, and threshold crossings within the step'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l precision -d 'Choose the floating-point precision [default: f32]' -r -f -a "f32\t'Single precision'
f64\t'Double precision'"
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l max-rate-error -d 'Use the fastest method whose rates err by at most X impulses/s, RMS over afferents' -r
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l rates-only -d 'Count spikes without keeping their times'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l csv -d 'Print one row per afferent: its class, place, spikes and rate'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand simulate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -s o -l out -d 'Write the pattern to PATTERN and name it after the file [default: stdout]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l seed -d 'Seed the search with N' -r
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l setting -d 'Choose the search space' -r -f -a "default\t'Motors may be off; 5 to 150 Hz'
always_on\t'All motors vibrate, as in the paper; 5 to 300 Hz'"
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l objective -d 'Choose what to maximise: ON afferents lie within reach of the target, OFF are all others' -r -f -a "contrast\t'Mean rate of ON minus mean rate of OFF, as in the paper'
off-rms\t'Mean of ON minus RMS of OFF: keeps dots apart, with `optimise --robust`'
off-rms-twice\t'Mean of ON minus twice the RMS of OFF: stricter'
near-off\t'As contrast; OFF afferents near the target weigh more'
auc\t'Chance that an ON afferent fires faster than an OFF one'
correlation\t'Correlation of the rates with the ON set'
rivals\t'Distance from the most similar shape, in SD of the counts'"
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l model -d 'Choose the models whose RA afferents are ON or OFF [default: both; with --objective contrast membrane, as in the paper]' -r -f -a "both\t'The gain over the rule naive-reach, under the model in which it is less'
membrane\t'RA afferents with a leaky membrane, as in the paper'
afferents\t'Skin mechanics, and RA afferents fitted to recordings'"
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l budget -d 'Stop after about N evaluations (per frame of a moving target; or N,N,... for each), or N seconds in all (Ns) [default: until nothing improves]' -r
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l rail-motors-at-once -d 'Let at most N motors of a 30 V rail have pulses at once, also in the naive rules; motors may then be off in every setting [default: no limit]' -r
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l resume -d 'Begin with the pattern in file PATTERN and improve it' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l robust -d 'Maximise the mean over eight populations of afferents, not one population'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand optimise" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l model -d 'Choose the model of skin and afferents; with --objectives, that of the searches [default: the scene\'s key `model`, else membrane]' -r -f -a "membrane\t'RA afferents with a leaky membrane, Gaussian receptive fields'
afferents\t'Skin under flat pins, and SA1, RA and PC afferents fitted to recordings; steps of 200 us'"
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l trace -d 'Use the stalls in FILE, recorded with the example `record_stalls` (with --stream)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l plot -d 'Draw the comparison into FILE (SVG)' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l stream -d 'Compare leads of the streamer, not methods: late bursts, onsets and bytes, in virtual time under recorded stalls'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l loop -d 'Compare position control, not methods: rest errors and amplitudes with their bounds, at all settings (minutes)'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l stop -d 'Compare surpluses of down bursts above a lower stop, not methods: rest errors with their theory (half a minute)'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l objectives -d 'Compare what a search maximises, not methods: patterns by each objective and by naive rules (minutes)'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand tradeoff" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l model -d 'Choose the model of skin and afferents' -r -f -a "membrane\t'RA afferents with a leaky membrane, Gaussian receptive fields'
afferents\t'Skin under flat pins, and SA1, RA and PC afferents fitted to recordings'"
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l trials -d 'Simulate N trials of each pattern on each finger, 8 to 1000' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l fingers -d 'Take the mean over N fingers, 1 to 100' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l seconds -d 'Let an interval last S seconds, 0.001 to 20' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l resolution-ms -d 'Read spike times in bins of MS milliseconds' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l efficiency -d 'Take an observer of efficiency X, above 0, at most 1: its d\' is sqrt(X) times the ideal one' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l efficiency-source -d 'State where the efficiency comes from; the answer repeats it' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l measured-percent -d 'Compute the efficiency of people who gave P per cent correct answers for these two patterns, above 50, below 100' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l seed -d 'Seed of the noise' -r
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l csv -d 'Write the matrix as CSV to FILE' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l plot -d 'Draw the matrix as SVG to FILE' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l matrix -d 'Show which pattern of the set an observer names when another is played'
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand discriminate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -s o -l out -d 'Keep the results in directory DIR; with a directory of this plan, compute what is missing' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l threads -d 'Use N threads [default: one per core]' -r
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l shard -d 'Compute part I of N equal parts [default: by SLURM_ARRAY_TASK_ID and SLURM_ARRAY_TASK_COUNT, else all]' -r
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l tasks -d 'Let the array have N tasks, up to 1000 and the site\'s limit [default: tasks of about 15 minutes, at most 500]' -r
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l status -d 'Show how far the sweep in directory DIR is' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l merge -d 'Join all rows in directory DIR: results.csv, results.parquet, page.html and the best patterns' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l pattern -d 'Print the pattern that cell N has found' -r
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l dry-run -d 'Measure some cells for a few seconds, print what all of them cost, and write nothing'
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l slurm -d 'Submit the missing cells to Slurm, as a job array; options for sbatch come after --'
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l axes -d 'List what a plan can vary'
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand sweep" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand validate" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand validate" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand report" -l out -d 'Write to directory DIR; make it if it does not exist' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand report" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand report" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l device -d 'Check this device, named as for `daemon` [default: the daemon\'s, else the first board]' -r
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l seconds -d 'Measure wake-ups for S seconds, 0.1 to 3600: the longer, the rarer the stalls it sees' -r
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l socket -d 'Connect to the daemon at PATH [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and /run/meissner/meissner.sock at which a daemon listens]' -r -F
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l board -d 'Have the board test itself: lines, waveform, memory, speed. The drivers stay off'
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -l json -d 'Print one JSON document on stdout and nothing else'
complete -c meissner -n "__fish_meissner_using_subcommand doctor" -s h -l help -d 'Print help'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "demo" -d 'Play a shipped edge on a simulated array and print a summary: daemon, device and client in one process'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "daemon" -d 'Drive a device for the clients of a socket, until SIGTERM'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "play" -d 'Play a pattern after the queued ones'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "sequence" -d 'Play a sequence of patterns with exact times, as one play'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "live" -d 'Play a stimulus that follows a mouse, a knob, a touchpad or the lines of stdin, until its source ends or Ctrl-C'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "stop" -d 'End the running play and clear the queue; the motors stay armed'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "estop" -d 'Turn all lines off at once; they stay off until `reset`'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "reset" -d 'Leave an emergency stop or a fault; the motors are disarmed'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "arm" -d 'Enable the motors'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "disarm" -d 'Return the pins and switch the motors off'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "home" -d 'Move the pins to their rest position, between plays'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "calibrate" -d 'Measure the gains of the motors and store them: by telemetry, in a minute of bursts, or with a laser (--plan, then --from)'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "list" -d 'List all patterns'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "show" -d 'Show the motors, drives and warnings of a pattern'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "import" -d 'Store a pattern file with the daemon, under the name in it'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "remove" -d 'Remove a pattern from the daemon\'s pattern directory'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "status" -d 'Show the state of the daemon, its device and its queue'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "events" -d 'Print events as they happen; with --json one document per line'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "receipt" -d 'Show the result of a play'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "session" -d 'Start, end, show, export and replay sessions: plays of one participant that are recorded together'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "token" -d 'Create, list and revoke access tokens of clients that come over the network'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "motor" -d 'Compute the steady state of a drive by the motor model, and its daily exposure'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "displacement" -d 'Sample how far a pattern moves each pin, by the motor model, as CSV'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "simulate" -d 'Simulate afferent spikes for a scene'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "optimise" -d 'Find a pattern for a target shape'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "tradeoff" -d 'Compare simulation methods on this machine, leads of the streamer, or position control'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "discriminate" -d 'Predict whether a finger can tell patterns apart: d\', per cent correct, confusion matrix'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "sweep" -d 'Run a plan of thousands of searches, simulations or comparisons, here or on a cluster'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "validate" -d 'Compare both models of skin and afferents with published figures'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "report" -d 'Draw figures of the models and of patterns, as SVG and CSV, and a page that shows them'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "doctor" -d 'Check what could keep this machine or its device from playing; exit 0 only if nothing does'
complete -c meissner -n "__fish_meissner_using_subcommand help; and not __fish_seen_subcommand_from demo daemon play sequence live stop estop reset arm disarm home calibrate list show import remove status events receipt session token motor displacement simulate optimise tradeoff discriminate sweep validate report doctor help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "start" -d 'Start a session; plays belong to it until it ends'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "end" -d 'End the running session'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "leave" -d 'Forget the session that this terminal has started; it goes on, and other commands of this terminal do not belong to it'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "list" -d 'List the recorded sessions, the oldest first'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "export" -d 'Export the recorded plays of a session as CSV, one row per stimulus; with --json as one document; exit 1 if the record does not have the session whole'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "replay" -d 'Play a recorded session again with the same gaps, and compare the receipts; exit 1 if something differs'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from session" -f -a "show" -d 'Show a session'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from token" -f -a "create" -d 'Create an access token and print it: the only time that it is shown'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from token" -f -a "list" -d 'List the access tokens, without their secrets'
complete -c meissner -n "__fish_meissner_using_subcommand help; and __fish_seen_subcommand_from token" -f -a "revoke" -d 'Revoke an access token; it is not valid from the next request on'
