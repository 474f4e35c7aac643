//! Tests with private items that answers of the second model do not depend on how they are computed.

use super::scene::{Pins, Scene};
use super::simulation::simulate_on;
use super::{motion, population};
use crate::method::Keep;
use meissner_array::motor::{HalfTick, Shaft};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_array::strokes::DriveStrokes;
use meissner_test_support::patterns::drive;
use pulp::Arch;
use rayon::ThreadPoolBuilder;

fn scene() -> Scene {
    let drives = vec![
        drive(9, 61.0, 80.0),
        Drive { start_s: Some(0.1), ..drive(14, 150.0, 80.0) },
        drive(0, 10.0, 300.0),
    ];
    let afferents = population(2).into();
    let pins = Pins::Drives(drives);
    Scene {
        array: Array::paper(),
        duration_s: 0.3,
        seed: 5,
        preindent_mm: 0.05,
        noise: true,
        pins,
        afferents,
        population: true,
    }
}

#[test]
fn every_width_of_vectors_and_number_of_threads_gives_the_same_spikes() {
    let scene = scene();
    let tracks = motion::tracks(&scene);
    let run = |arch| simulate_on(arch, &scene, &tracks, Keep::Spikes, &|_| ()).unwrap();
    let scalar = run(Arch::Scalar);
    let firing = scalar.counts.iter().filter(|&&count| count > 0).count();
    assert!(firing > 25, "{firing}");
    // 300 um lift the pins beside it off the skin, which is pressed in by 50 um.
    assert!(
        scalar.lost_contact_s[1] > 0.05 && scalar.lost_contact_s[0] == 0.0,
        "{:?}",
        scalar.lost_contact_s
    );
    for arch in crate::tests::widths() {
        assert!(run(arch) == scalar, "{arch:?}");
    }
    for threads in [1, 3] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| run(Arch::new())) == scalar, "{threads}");
    }
}

#[test]
fn a_motors_samples_are_its_shafts_displacements() {
    let scene = scene();
    let tracks = motion::tracks(&scene);
    let mut motion = motion::Motion::new(&scene, &tracks);
    let mut columns = vec![Vec::new(); 24];
    for samples in [1, 63, 1000, 436] {
        motion.extend(samples, &mut columns);
    }
    let Pins::Drives(drives) = scene.pins() else { unreachable!("it has drives") };
    for of in drives {
        let array = scene.array();
        let (mut shaft, um_per_pulse) = (Shaft::new(array.motor()), array.motor().um_per_pulse);
        let mut ramps =
            DriveStrokes::of(array, of).unwrap().flat_map(|stroke| stroke.ramps(um_per_pulse)).peekable();
        for (sample, &found) in columns[usize::from(of.motor)].iter().enumerate() {
            // 17 ticks are a sample.
            let tick = 17 * sample as u64;
            while let Some(ramp) = ramps.next_if(|ramp| ramp.start.0 <= tick) {
                shaft.push(ramp);
            }
            let expected_mm = 0.05 + 1e-3 * shaft.displacement_um(HalfTick(2 * tick));
            assert!(
                (found - expected_mm).abs() < 1e-12,
                "motor {} at {sample}: {found} {expected_mm}",
                of.motor
            );
        }
    }
    assert!(columns[5].iter().all(|&mm| mm == 0.05));
}
