"""PsychoPy plugin for meissner, the driver of a tactile display: a device and a Builder component.

    display = deviceManager.addDevice("psychopy_meissner.device.MeissnerDevice", "display", simulated=True)
    play = display.client.play("edge-45", seconds=0.3)

In Builder the component `Meissner` writes such code. The data path: `component` writes the lines of `script` into the
experiment; they call `routine.TactilePlay`, which orders plays through `device.MeissnerDevice`; the client is the package `meissner`.
"""

__version__ = "0.1.0"
