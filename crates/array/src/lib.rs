//! The pin array and its motors, from a pattern file to the displacement of each pin.
//!
//! The modules, in the order of the data path:
//!
//! 1. [`spec`]: the description of an array: pins, carrier, wiring, motors; [`per_motor`]: a value for each motor.
//! 2. [`pattern`]: reads and checks pattern files: which pins vibrate, at which frequency, amplitude and phase, and when.
//! 3. [`reflected_walk`]: theory of the rest error of a pin above a lower stop, and the surplus that keeps it small.
//! 4. [`strokes`]: compiles a pattern to strokes and moves at exact ticks. The streamer, the simulated motors and the skin model all use it.
//! 5. [`motor`]: the model of an ideal motor: a square wave becomes bursts of pulses, bursts become displacement.
//! 6. [`displacement`]: samples of the pins' displacement in a play, by ideal motors.
//! 7. [`samples`]: displacement from NPY, WAV and CSV files; [`motion`]: any waveform of displacement, compiled to moves, and what a motor reaches of it.
//! 8. [`simulated`]: the simulated motors of an array, with scatter, asymmetry, end stops and telemetry.
//! 9. [`power`]: how many motors have pulses at once, and the current of a rail.
//!
//! [`units`] converts seconds, ticks and micrometres. [`random`] makes random numbers that depend on a key alone.
//!
//! The crate opens no file and reads no clock.
//!
//! ```
//! use meissner_array::motor::{HalfTick, Shaft};
//! use meissner_array::pattern::Pattern;
//! use meissner_array::spec::Array;
//! use meissner_array::strokes::{DriveStrokes, StrokeOptions, Strokes};
//!
//! let text = r#"
//!     format = 1
//!     name = "pin-9"
//!     duration_s = 0.1
//!     [[drive]]
//!     motor = 9
//!     frequency_hz = 60.0
//!     amplitude_um = 80.0
//! "#;
//! let pattern = Pattern::parse(text, "pin-9.toml")?;
//! let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(1.0))?.collect::<Result<Vec<_>, _>>()?;
//! assert_eq!(strokes.len(), 60);
//! assert_eq!((strokes[0].pulses(), strokes[1].begin().0), (2 * 589, 1417));
//!
//! // The displacement of the pin's shaft when the first burst up is over, and 4.3 ms later.
//! let array = Array::paper();
//! let mut shaft = Shaft::new(array.motor());
//! let first = DriveStrokes::of(array, &pattern.drives()[0])?.next().unwrap();
//! shaft.push(first.ramps(array.motor().um_per_pulse)[0]);
//! assert!(shaft.displacement_um(HalfTick(2 * 589)) < 60.0);
//! assert!((shaft.displacement_um(HalfTick(2 * 589 + 731)) - 80.0).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod displacement;
pub mod motion;
pub mod motor;
pub mod pattern;
pub mod per_motor;
pub mod power;
pub mod random;
pub mod reflected_walk;
pub mod samples;
pub mod simulated;
pub mod spec;
pub mod strokes;
pub mod units;
