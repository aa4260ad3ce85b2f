//! The best rate of a clock that delays of a known law allow: equation (61a).

use wimu_testkit::{Random, figure};

/// Logarithm of a sum of exponentials.
fn log_sum(logs: &[f64]) -> f64 {
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + logs.iter().map(|log| (log - most).exp()).sum::<f64>().ln()
}

/// Delays whose law is known, but for where they begin.
#[derive(Clone, Copy, Debug)]
enum Law {
    /// Up to so much, ns, that is not known either.
    Uniform(f64),
    /// With this mean, ns.
    Exponential(f64),
}

/// The error of the best slope there is, ppm, over sessions: `each` transfers a second in
/// each direction, which keep their order, over a link whose law is known. It is the mean over all
/// slopes and places of the line, weighted by what they make the arrivals likely: no estimate that moves along with
/// the arrivals has a smaller mean square error: equation (61a).
fn best_possible(law: Law, each: f64, duration_s: f64, seeds: u64) -> f64 {
    const STEPS: i32 = 40;
    let mut squares = 0.0;
    let (wide, most) = match law {
        Law::Uniform(most) => (most, 12.0),
        Law::Exponential(mean) => (mean, 40.0),
    };
    for seed in 0..seeds {
        let mut random = Random::new(seed * 7919 + 5);
        let mut sides = Vec::new();
        for _ in 0..2 {
            let mut side = Vec::new();
            let mut latest = f64::NEG_INFINITY;
            for index in 0..(each * duration_s) as usize {
                let x = (index as f64 + 0.5 * random.uniform()) / each - duration_s / 2.0;
                let delay = match law {
                    Law::Uniform(most) => most * random.uniform(),
                    Law::Exponential(mean) => -mean * (1.0 - random.uniform()).ln(),
                };
                // What comes with the one before had less delay than that.
                let free = x * 1e9 + delay > latest;
                latest = latest.max(x * 1e9 + delay);
                side.push((x, latest - x * 1e9, free));
            }
            sides.push(side);
        }
        let mut found = Vec::new();
        for step in -STEPS..=STEPS {
            let slope = most * 1e3 * f64::from(step) / f64::from(STEPS);
            let sum = |side: &Vec<(f64, f64, bool)>| {
                let turned = |(x, v, free): &(f64, f64, bool)| (v - slope * x, *free);
                let all: Vec<_> = side.iter().map(turned).collect();
                let values = all.iter().map(|(v, _)| *v);
                // The line is below what is only known to have had less delay, too.
                let least = values.clone().fold(f64::INFINITY, f64::min);
                let latest = values.fold(f64::NEG_INFINITY, f64::max);
                let mut depth = 1e-5 * wide;
                let mut logs = Vec::new();
                while depth < wide {
                    let place = least - depth;
                    let count = all.len() as f64;
                    let mut log = match law {
                        // Summed up over the width, too.
                        Law::Uniform(_) => -(count - 1.0) * (latest - place).ln(),
                        Law::Exponential(_) => 0.0,
                    };
                    for (v, free) in &all {
                        match (law, free) {
                            (Law::Uniform(_), false) => log += (v - place).ln(),
                            (Law::Uniform(_), true) => {}
                            (Law::Exponential(mean), true) => log -= (v - place) / mean,
                            (Law::Exponential(mean), false) => {
                                log += (-((place - v) / mean).exp_m1()).ln();
                            }
                        }
                    }
                    logs.push(log + depth.ln());
                    depth *= 1.25;
                }
                log_sum(&logs)
            };
            found.push((slope, sides.iter().map(sum).sum::<f64>()));
        }
        let all = log_sum(&found.iter().map(|(_, log)| *log).collect::<Vec<_>>());
        let mean: f64 = found.iter().map(|(at, log)| (log - all).exp() * at).sum();
        squares += (mean * 1e-3).powi(2);
    }
    (squares / seeds as f64).sqrt()
}

#[test]
#[ignore = "minutes: cargo xtask campaign clocks"]
fn best_possible_rates_with_known_laws() {
    for (law, each, name) in [
        (Law::Uniform(50e6), 20.0, "uniform"),
        (Law::Uniform(50e6), 60.0, "uniform"),
        (Law::Exponential(50e6), 10.0, "exponential"),
        (Law::Exponential(50e6), 20.0, "exponential"),
        (Law::Exponential(50e6), 60.0, "exponential"),
    ] {
        let rms = best_possible(law, each, 60.0, 200);
        let claim = format!("best rate, {name} 50 ms, 60 s, {each} transfers/s: ppm rms");
        figure(&claim, format!("{rms:.2}"), "below 2", rms < 2.0);
    }
}
