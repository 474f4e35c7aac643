"""The lines that the Builder component adds to an exported script; `component` fills in `%(parameter)s`.

`NOT_STARTED`, `win`, `tThisFlip` and so on are names of every script that Builder exports.
"""

IMPORTS = (("shared", "psychopy_meissner.device", "meissnerDevice"), ("TactilePlay", "psychopy_meissner.routine", ""))
"""Name, module, and the name in the script, if another."""

INIT = """
# connect %(name)s to the display; at the end the motors are switched off first
%(name)s = TactilePlay(
    meissnerDevice(
        deviceManager, %(deviceName)s,
        address=%(address)s, token=%(token)s, simulated=%(simulatedCode)s,
        checked=%(checked)s, participant=%(participant)s,
    ),
    %(ahead)s
)
runAtExit.insert(0, %(name)s.device.close)
"""

ROUTINE_START = "%(name)s.reset()\n"

PLAN = """
# order %(name)s ahead of its start
if %(name)s.status == NOT_STARTED:
    %(name)s.plan(%(startCode)s, tThisFlip, tThisFlipGlobal, period=%(periodCode)s)
"""

START = "%(name)s.start(%(onsetCode)s)\n"

IS_OVER = "or %(name)s.isOver"

STOP = "%(name)s.stop()\n"

ROUTINE_END = """
# end %(name)s, and save the times at which it was played
for _column, _value in %(name)s.finish().items():
    thisExp.addData('%(name)s.' + _column, _value)
"""
