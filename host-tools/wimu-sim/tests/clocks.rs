//! The clock models of both links of a simulated board, with faults on the wireless one, against its true clock.

use crate::session;

use session::*;
use wimu_host::clock::ClockModel;
use wimu_host::mcap_file::Recorded;
use wimu_link::LinkRole;
use wimu_model::DeviceTimeUs;

#[test]
fn after_a_minute_on_a_bad_link_the_clock_is_known() {
    let (mut inside, mut squares) = ([0; 2], [0.0; 2]);
    for seed in 1..=5 {
        let session = Session {
            seed,
            ..Session::default()
        };
        let file = session.record();
        for (which, model) in clocks(&file).into_iter().enumerate() {
            let (rate, rate_sd) = model.rate_ppm();
            // Host time per device time.
            let rate_error = rate - (1.0 / (1.0 + session.clock_ppm * 1e-6) - 1.0) * 1e6;
            let mut worst = 0.0_f64;
            for second in [1.0, 15.0, 30.0, 45.0, 59.0] {
                let time = DeviceTimeUs((second * 1e6) as u64);
                let error = model.host_ns(time) as f64 - session.truth_ns(second * 1e6);
                // A link alone knows the rate, and with it the ends, less well than the middle.
                if which == 0 || second == 30.0 {
                    worst = worst.max(error.abs());
                }
                inside[which] += u32::from(error.abs() <= 2.0 * model.sd_ns(time));
            }
            let name = ["both links", "wireless alone"][which];
            println!(
                "seed {seed}, {name}: offset wrong by {:.3} ms at most, rate by {rate_error:+.2} ± {:.2} ppm",
                worst * 1e-6,
                2.0 * rate_sd
            );

            assert!(worst < 1e6, "{name} {seed}: {worst} ns");
            let known = if which == 0 { 2.0 } else { 2.0 * rate_sd + 1.0 };
            assert!(rate_error.abs() < known, "{name} {seed}: {rate_error} ppm");
            squares[which] += rate_error * rate_error;
        }
    }
    assert!((squares[1] / 5.0_f64).sqrt() < 2.0, "{squares:?}");
    println!("within two standard deviations: {inside:?} of 25");
    assert!(inside.iter().all(|inside| *inside >= 22), "{inside:?}");
}

#[test]
fn shorter_answers_of_the_first_seconds_shift_no_clock_of_a_slow_line() {
    let session = Session {
        wireless: "baud=38400,latency=5ms",
        links: &[LinkRole::Wireless],
        seconds: 12.0,
        ..Session::default()
    };
    let [_, model] = clocks(&session.record());
    let offset_ns = model.host_ns(DeviceTimeUs(6_000_000)) as f64 - session.truth_ns(6e6);
    // A byte takes 0.26 ms.
    assert!(offset_ns.abs() < 5e4, "{offset_ns} ns");
}

/// Errors over many sessions of rate, ppm, and of offset in the middle, ms.
#[derive(Default)]
struct Figures {
    sessions: u32,
    squares: [f64; 2],
    within: [u32; 2],
    held: [u32; 2],
}

impl Figures {
    fn add(&mut self, session: &Session, model: &ClockModel) {
        let (rate, rate_sd) = model.rate_ppm();
        let rate_error = rate - (1.0 / (1.0 + session.clock_ppm * 1e-6) - 1.0) * 1e6;
        let middle_us = session.seconds * 5e5;
        let middle = DeviceTimeUs(middle_us as u64);
        let offset = (model.host_ns(middle) as f64 - session.truth_ns(middle_us)) * 1e-6;
        let errors = [(rate_error, rate_sd), (offset, model.sd_ns(middle) * 1e-6)];
        println!(
            "  seed {}: rate wrong by {rate_error:+.2} ± {:.2} ppm, offset by {offset:+.3} ms",
            session.seed,
            2.0 * rate_sd
        );
        self.sessions += 1;
        for (which, (error, sd)) in errors.into_iter().enumerate() {
            self.squares[which] += error * error;
            self.within[which] += u32::from(error.abs() <= [2.0, 1.0][which]);
            self.held[which] += u32::from(error.abs() <= 1.96 * sd);
        }
    }

    fn print(&self, of: &str) {
        let Self {
            sessions,
            within,
            held,
            ..
        } = self;
        let [rate, offset] = self.squares.map(|sum| (sum / f64::from(*sessions)).sqrt());
        println!(
            "{of}: of {sessions} sessions of 60 s: rate {rate:.2} ppm rms, within 2 ppm {}, intervals hold {}; offset {offset:.3} ms rms, within 1 ms {}, held {}",
            within[0], held[0], within[1], held[1]
        );
    }
}

/// The seeds that figures are of: 1 to 40, or `SEEDS=41-80`.
fn seeds() -> std::ops::RangeInclusive<u64> {
    let said = std::env::var("SEEDS").ok();
    let range = said.as_deref().and_then(|said| said.split_once('-'));
    range.map_or(1..=40, |(first, last)| {
        first.parse().unwrap()..=last.parse().unwrap()
    })
}

#[test]
#[ignore = "prints the figures of eighty sessions"]
fn figures_of_the_wireless_link_alone() {
    const EXPONENTIAL: &str =
        "baud=115200,loss=2%,burst=20,bits=1e-4,latency=15ms,jitter=exp:50ms,stall=3s@30s";
    for wireless in [BAD, EXPONENTIAL] {
        let mut figures = Figures::default();
        for seed in seeds() {
            let session = Session {
                seed,
                wireless,
                ..Session::default()
            };
            let [_, model] = clocks(&session.record());
            figures.add(&session, &model);
        }
        figures.print(wireless);
    }
}

#[test]
#[ignore = "prints the figures of many sessions"]
fn figures_of_slow_lines() {
    for (wireless, baud) in [
        ("baud=38400,latency=15ms,jitter=50ms", 38_400.0),
        ("baud=38400,latency=5ms,jitter=5ms", 38_400.0),
        ("baud=19200,latency=15ms,jitter=50ms", 19_200.0),
        ("baud=9600,latency=15ms,jitter=50ms", 9600.0),
    ] {
        let mut figures = Figures::default();
        let (mut often, mut shed, mut lost) = (0.0_f64, 0, 0);
        for seed in seeds() {
            let session = Session {
                seed,
                wireless,
                ..Session::default()
            };
            let file = session.record();
            let [_, model] = clocks(&file);
            figures.add(&session, &model);
            // The part of the line that questions take, in the worst second.
            let mut asked = [0; 61];
            for entry in entries(&file) {
                if let Recorded::Sent {
                    role,
                    host_ns,
                    bytes,
                } = entry
                    && role == LinkRole::Wireless
                {
                    asked[(host_ns / 1_000_000_000).min(60) as usize] += bytes.len();
                }
            }
            let most = asked.iter().skip(3).max().copied().unwrap_or_default();
            often = often.max(most as f64 * 10.0 / baud);
            let link = &compared(&file).unwrap().links[1];
            shed += link.shed.unwrap_or_default();
            lost += link.lost;
        }
        figures.print(wireless);
        println!(
            "  questions take {:.0} % of the line in the worst second after the third; {shed} frames left out, {lost} samples lost",
            100.0 * often
        );
    }
}
