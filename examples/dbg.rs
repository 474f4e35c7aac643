use meissner::stream::{Gains, Trial};
fn main() {
    let certain = |gain: f64| Gains { mean: [gain; 2], sd: [1e-9; 2], scatter: 1e-3 };
    let t = Trial {
        frequency_hz: 10.0,
        amplitude_um: 200.0,
        scatter: 0.0,
        asymmetry: 0.0,
        age_ms: 100.0,
        offset_um: 15.0,
        gains: certain(1.0 / 0.8),
        ..Trial::default()
    };
    for off in [15.0, 0.0] {
        let t = Trial { offset_um: off, ..t };
        t.run(
            1.5,
            |_, y| Some(y),
            |p| {
                println!(
                    "{:.3} top {:.2} rest {:.2} {:?}",
                    p.up as f64 / 85000.0,
                    p.top_um,
                    p.rest_um,
                    p.pulses
                )
            },
        )
        .unwrap();
        println!();
    }
    let t = Trial { scatter: 0.0, asymmetry: 0.0, offset_um: 100.0, age_ms: 5.0, ..Trial::default() };
    let mut n = 0;
    t.run(
        4.5,
        |_, y| Some(y),
        |p| {
            n += 1;
            if n < 12 || n % 30 == 0 {
                println!(
                    "{:.3} top {:.2} rest {:.2} {:?}",
                    p.up as f64 / 85000.0,
                    p.top_um,
                    p.rest_um,
                    p.pulses
                )
            }
        },
    )
    .unwrap();
}
