//! Scenes and methods that are refused: the error names the key that a file would have.

use super::{drive, model, scene, stepped, under};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_skin::{Options, Scene, simulate};

const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

fn refusal(duration_s: f64, drive: Drive, afferent: Position, model: AfferentModel) -> String {
    Scene::new(Array::paper(), duration_s, 7, vec![drive], vec![afferent], model).unwrap_err().to_string()
}

#[test]
fn a_number_out_of_range_is_refused_by_its_name() {
    let (plain, good) = (drive(9, 60.0, 80.0), model(Rectify::Half));
    let asked = |name: &str, wrong: &[f64], of: &dyn Fn(f64) -> String| {
        for &wrong in wrong.iter().chain(&NOT_FINITE) {
            let line = of(wrong);
            assert!(line.contains(name) && !line.contains('\n'), "{wrong} as {name}: {line}");
        }
    };
    asked("`duration_s`", &[-1e-9, 1.1e9], &|wrong| refusal(wrong, plain, under(9), good));
    let driven = |drive| refusal(1.0, drive, under(9), good);
    asked("`drives[0].frequency_hz`", &[0.0, -0.0, -60.0, 42_500.0_f64.next_up()], &|wrong| {
        driven(Drive { frequency_hz: wrong, ..plain })
    });
    asked("`drives[0].amplitude_um`", &[-f64::from_bits(1), 1.1e6], &|wrong| {
        driven(Drive { amplitude_um: wrong, ..plain })
    });
    asked("`drives[0].phase`", &[-f64::from_bits(1), 1.0], &|wrong| driven(Drive { phase: wrong, ..plain }));
    asked("`drives[0].start_s`", &[-f64::from_bits(1), 1.1e9], &|wrong| {
        driven(Drive { start_s: Some(wrong), ..plain })
    });
    asked("`drives[0].stop_s`", &[-1.0, 0.0, 1.1e9], &|wrong| driven(Drive { stop_s: Some(wrong), ..plain }));
    let placed = |at| refusal(1.0, plain, at, good);
    asked("`afferents[0].x_mm`", &[-1.1e6, 1.1e6], &|x_mm| placed(Position { x_mm, y_mm: 0.0 }));
    asked("`afferents[0].y_mm`", &[-1.1e6, 1.1e6], &|y_mm| placed(Position { x_mm: 0.0, y_mm }));
    let made = |model| refusal(1.0, plain, under(9), model);
    asked("`afferent.alpha_per_um`", &[-1e-12, -f64::from_bits(1), 1.1e15], &|alpha_per_um| {
        made(AfferentModel { alpha_per_um, ..good })
    });
    asked("`afferent.tau_s`", &[0.0, f64::from_bits(1), -0.044, 1.1e9], &|tau_s| {
        made(AfferentModel { tau_s, ..good })
    });
    asked("`afferent.refractory_s`", &[0.0, 1e-5_f64.next_down(), 1.1e9], &|refractory_s| {
        made(AfferentModel { refractory_s, ..good })
    });
    asked("`afferent.hyperexcitability_s`", &[-1e-3, 1.1e9], &|hyperexcitability_s| {
        made(AfferentModel { hyperexcitability_s, ..good })
    });
    asked("`afferent.hyperexcitability_depth`", &[-1e-9, 1.0_f64.next_up()], &|hyperexcitability_depth| {
        made(AfferentModel { hyperexcitability_depth, ..good })
    });
    asked("`afferent.sigma_mm`", &[0.0, 1e-3_f64.next_down(), -1.1, 1.1e6], &|sigma_mm| {
        made(AfferentModel { sigma_mm, ..good })
    });
    asked("`afferent.noise_sd`", &[-0.05, 1.1e6], &|noise_sd| made(AfferentModel { noise_sd, ..good }));
}

#[test]
fn a_step_out_of_range_is_refused() {
    let scene = scene(1.0, &[drive(9, 60.0, 80.0)], &[under(9)], model(Rectify::Half));
    for step_us in [0, 1_000_001, u32::MAX] {
        for method in stepped(step_us) {
            let line = simulate(&scene, &Options::rates(method), &|_| ()).unwrap_err().to_string();
            assert!(line.contains(&step_us.to_string()), "{line}");
        }
    }
}
