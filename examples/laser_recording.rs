//! Writes what a laser would record of a simulated motor: to try `meissner calibrate --from` without a laser.
//!
//! `cargo run --release --example laser_recording -- calibration-plan.json [SEED] > laser.csv` replays the plan that
//! `meissner calibrate --plan` has played on the simulated array of that seed (the daemon's `mock.seed`, default 0) with its
//! other settings at their defaults. The sensor has 0.1 µm noise, drift, gaps, and a clock that is 500 ppm fast.

use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_stream::calibrate::{PlayedPlan, Sensor, simulated_recording};
use std::error::Error;
use std::io::Write;
use std::{env, fs, io};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let plan =
        arguments.next().ok_or("name the plan's file, as `meissner calibrate --plan` has written it")?;
    let seed = arguments.next().map_or(Ok(0), |text| text.parse())?;
    let played = PlayedPlan::parse(&fs::read_to_string(plan)?)?;
    let motors = SimulatedMotorsConfig { seed, ..SimulatedMotorsConfig::default() };
    let text = simulated_recording(&played, &motors, &Sensor::default());
    Ok(io::stdout().write_all(text.as_bytes())?)
}
