//! Writes the description of a new array.

/// A new array in rows and columns, with the motors of the default array.
#[derive(Clone, Debug, PartialEq)]
pub struct NewArray {
    /// Its name.
    pub name: String,
    /// Rows of pins.
    pub rows: u8,
    /// Columns of pins.
    pub columns: u8,
    /// Distance of neighbouring pins, mm.
    pub pitch_mm: f64,
    /// The carrier, Hz; without one, the default array's.
    pub tick_hz: Option<u32>,
}

impl NewArray {
    /// The text of its description, with two motors on a chip and six on a rail, and comments on what to change.
    pub fn to_toml(&self) -> String {
        let Self { name, rows, columns, pitch_mm, tick_hz } = self;
        let like = super::Array::paper();
        let motors = u32::from(*rows) * u32::from(*columns);
        let per = |groups: &super::Groups| {
            let size = groups.largest() as u32;
            let lists = (0..motors).step_by(size as usize).map(|first| {
                let list: Vec<_> = (first..motors.min(first + size)).map(|motor| motor.to_string()).collect();
                format!("[{}]", list.join(", "))
            });
            lists.collect::<Vec<_>>().join(", ")
        };
        let (tick_hz, duty, motor) = (tick_hz.unwrap_or(like.rate().hz()), like.duty(), like.motor());
        let window_ms = like.rate().ticks_to_ms(1) * motor.window_ticks();
        let rest_s = like.rate().ticks_to_seconds(motor.transient_rest_ticks);
        // Pins nearer than 1 mm need thinner tips than those without a radius.
        let radius =
            if *pitch_mm > 1.0 { String::new() } else { format!(", radius_mm = {:.3}", 0.4 * pitch_mm) };
        format!(
            "# {rows} x {columns} pins. A motor's number is {columns} * row + column; row 0 is the most distal.\n\
             name = \"{name}\"\n\
             # Or: positions_mm = [[x, y], ...], one for each motor; x runs across the finger, y towards its tip. radius_mm is that of a pin's tip.\n\
             pins = {{ rows = {rows}, columns = {columns}, pitch_mm = {pitch_mm:?}{radius} }}\n\
             # The carrier: pulses per second. Exact times are counted in its ticks.\n\
             tick_hz = {tick_hz}\n\
             # For how much of a tick a line is high in a pulse up and in a pulse down.\n\
             duty = {{ up = {:?}, down = {:?} }}\n\
             # The motors of each supply and of each driver chip: change them to your wiring.\n\
             rails = [{}]\n\
             chips = [{}]\n\n\
             # The motors of the default array, until you have measured yours.\n\
             [motor]\n\
             # Travel per pulse, and the window of the moving average with which a shaft follows its pulses.\n\
             step_um = {:?}\n\
             window_ms = {window_ms:?}\n\
             # The largest amplitude of a drive, and the controller's limit on pulses whatever a host asks.\n\
             travel_um = {:?}\n\
             most_pulses = {}\n\
             # The fewest pulses of a burst for which step_um was measured, and the most of a seek of the lower stop.\n\
             least_pulses = {}\n\
             seek_pulses = {}\n\
             # The first burst after a rest falls short.\n\
             transient = {{ rest_s = {rest_s:?}, gain = {:?} }}\n",
            duty.up,
            duty.down,
            per(like.rails()),
            per(like.chips()),
            motor.um_per_pulse,
            motor.travel_um,
            motor.most_pulses,
            motor.least_pulses,
            motor.seek_pulses,
            motor.transient_gain,
        )
    }
}
