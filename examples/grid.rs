use meissner::stream::Trial;
use rayon::prelude::*;
fn bound(t: &Trial, a: f64) -> f64 {
    // closed form, N averaged over phases of samples against bursts
    let q2 = t.scatter * t.scatter * a * a / (1.0 - t.scatter * t.scatter);
    let half = 1000.0 / t.frequency_hz / 2.0;
    let d = t.delay_ms();
    let n = 1.0 + (d / half).floor();
    (q2 * n + 0.0392f64.powi(2)).sqrt()
}
fn main() {
    let scale: f64 = std::env::args().nth(1).map_or(1.0, |s| s.parse().unwrap());
    let mut cells = vec![];
    for f in [1.0, 10.0, 60.0, 150.0, 300.0] {
        for a in [2.0, 10.0, 80.0, 200.0] {
            for age in [1.0, 5.0, 20.0, 100.0] {
                for s in [0.0, 0.1, 0.3] {
                    for asym in [0.0, 0.02, 0.1] {
                        for lead in [100.0] {
                            cells.push(Trial {
                                frequency_hz: f,
                                amplitude_um: a,
                                lead_ms: lead,
                                age_ms: age,
                                scatter: s,
                                asymmetry: asym,
                                seed: 7,
                                ..Trial::default()
                            });
                        }
                    }
                }
            }
        }
    }
    let t0 = std::time::Instant::now();
    let rows: Vec<_> = cells
        .par_iter()
        .map(|t| {
            let secs = (20.0f64).max(2000.0 / t.frequency_hz) * scale;
            let skip = (2.0f64).max(10.0 * t.delay_ms() / 1000.0) * 85000.0;
            let (mut n, mut ss, mut amp, mut lastrest, mut planned, mut worst) =
                (0u64, 0.0, 0.0, 0.0, 0.0, 0.0f64);
            let doubt = t
                .run(
                    secs,
                    |_, y| Some(y),
                    |p| {
                        if p.up as f64 > skip {
                            n += 1;
                            ss += p.rest_um * p.rest_um;
                            amp += p.top_um - (p.rest_um + lastrest) / 2.0;
                            worst = worst.max(p.rest_um.abs());
                        }
                        lastrest = p.rest_um;
                        planned = p.planned_um;
                    },
                )
                .unwrap();
            (*t, (ss / n as f64).sqrt(), amp / n as f64, planned, worst, doubt)
        })
        .collect();
    eprintln!("{:?}", t0.elapsed());
    let mut bad = 0;
    for (t, rms, amp, planned, worst, doubt) in rows {
        let b = bound(&t, planned);
        let lim = if t.scatter == 0.0 {
            0.1357
        } else if t.scatter <= 0.1 {
            1.2 * b
        } else {
            1.5 * b
        };
        let room = 85000.0 / t.frequency_hz / 2.0 / (planned / 0.1357);
        let amp_bad = room >= 1.3 && (amp - planned).abs() > (0.01 * planned).max(0.068);
        if (room < 1.3 && t.scatter > 0.0 && t.asymmetry != 0.02 && (t.age_ms == 1.0 || t.age_ms == 20.0))
            || rms > lim
        {
            bad += 1;
            println!(
                "f {} A {} (fits {:.1}) age {} s {} asym {}: rms {:.3} bound {:.3} ratio {:.2} amp {:.2} room {:.2} worst {:.1} {:?} {}{}",
                t.frequency_hz,
                t.amplitude_um,
                planned,
                t.age_ms,
                t.scatter,
                t.asymmetry,
                rms,
                b,
                rms / b,
                amp,
                room,
                worst,
                doubt,
                if rms > lim { "RMS " } else { "" },
                if amp_bad { "AMP" } else { "" }
            );
        }
    }
    println!("{bad} bad");
}
