//! The clock models of both links of a simulated board, with faults on the wireless one, against its true clock.

use crate::session;

use session::*;
use wimu_host::clock::ClockModel;
use wimu_host::mcap_file::Recorded;
use wimu_link::LinkRole;
use wimu_model::DeviceTimeUs;
use wimu_testkit::{Coverage, Lane, coverage_figure, figure};

/// Jitter of the wireless link that is exponential, mean 50 ms.
const EXPONENTIAL: &str =
    "baud=115200,loss=2%,burst=20,bits=1e-4,latency=15ms,jitter=exp:50ms,stall=3s@30s";

#[test]
fn after_a_minute_on_a_bad_link_the_clock_is_known() {
    // A session takes two seconds.
    let sessions = Lane::current().choose([1, 2, 120]);
    let mut inside = [Coverage::default(); 2];
    let (mut offset_ms, mut rate_ppm) = (0.0_f64, 0.0_f64);
    let mut alone = Figures::default();
    for seed in 1..=sessions {
        let session = Session { seed, ..Session::default() };
        let file = session.record();
        let [both, wireless] = clocks(&file);
        for (which, model) in [&both, &wireless].into_iter().enumerate() {
            for second in [1.0, 15.0, 30.0, 45.0, 59.0] {
                let time = DeviceTimeUs((second * 1e6) as u64);
                let error = model.host_ns(time) as f64 - session.truth_ns(second * 1e6);
                inside[which].count(error.abs() <= 1.96 * model.sd_ns(time));
                // A link alone knows the rate, and with it the ends, less well than the middle.
                if which == 0 {
                    offset_ms = offset_ms.max(error.abs() * 1e-6);
                }
            }
        }
        rate_ppm = rate_ppm.max(rate_error(&session, &both).abs());
        alone.add(&session, &wireless);
    }
    let claim = "clock by both links, 60 s: largest offset of five moments, ms";
    figure(claim, format!("{offset_ms:.2}"), "below 1", offset_ms < 1.0);
    let claim = "clock by both links, 60 s: largest error of the rate, ppm";
    figure(claim, format!("{rate_ppm:.2}"), "below 2", rate_ppm < 2.0);
    alone.record("bad link alone");
    assert!(offset_ms < 1.0 && rate_ppm < 2.0, "{offset_ms} {rate_ppm}");
    // The stated deviation includes a part for directions that take unequally long, which these do not.
    for (inside, name) in inside.into_iter().zip(["both links", "wireless alone"]) {
        println!("{name}: 95 % intervals of the offset hold {inside}");
        inside.assert_can_be(0.93..=1.0, name);
    }
    for held in alone.held {
        held.assert_can_be(0.93..=1.0, "wireless alone");
    }
    let near = alone.within[1];
    near.assert_can_be(0.98..=1.0, "wireless alone, offset within 1 ms");
    assert!(alone.rms()[0] < 2.0, "{:?}", alone.rms());
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

/// Error of the rate, host time per device time, ppm.
fn rate_error(session: &Session, model: &ClockModel) -> f64 {
    model.rate_ppm().0 - (1.0 / (1.0 + session.clock_ppm * 1e-6) - 1.0) * 1e6
}

/// Errors over many sessions of rate, ppm, and of offset in the middle, ms.
#[derive(Default)]
struct Figures {
    squares: [f64; 2],
    /// Within 2 ppm and 1 ms.
    within: [Coverage; 2],
    /// Within 1.96 stated standard deviations.
    held: [Coverage; 2],
}

impl Figures {
    fn add(&mut self, session: &Session, model: &ClockModel) {
        let (rate_error, (_, rate_sd)) = (rate_error(session, model), model.rate_ppm());
        let middle_us = session.seconds * 5e5;
        let middle = DeviceTimeUs(middle_us as u64);
        let offset = (model.host_ns(middle) as f64 - session.truth_ns(middle_us)) * 1e-6;
        let errors = [(rate_error, rate_sd), (offset, model.sd_ns(middle) * 1e-6)];
        println!(
            "  seed {}: rate wrong by {rate_error:+.2} ± {:.2} ppm, offset by {offset:+.3} ms",
            session.seed,
            1.96 * rate_sd
        );
        for (which, (error, sd)) in errors.into_iter().enumerate() {
            self.squares[which] += error * error;
            self.within[which].count(error.abs() <= [2.0, 1.0][which]);
            self.held[which].count(error.abs() <= 1.96 * sd);
        }
    }

    /// Rate, ppm, and offset, ms.
    fn rms(&self) -> [f64; 2] {
        let count = self.held[0].total() as f64;
        self.squares.map(|sum| (sum / count).sqrt())
    }

    fn record(&self, link: &str) {
        let [rate, offset] = self.rms();
        let claim = format!("{link}, 60 s: rate, ppm rms, sessions within 2 ppm");
        let measured = format!("{rate:.2}, {}", self.within[0]);
        figure(&claim, measured, "below 2", rate < 2.0);
        let claim = format!("{link}, 60 s: offset, ms rms, sessions within 1 ms");
        let measured = format!("{offset:.2}, {}", self.within[1]);
        figure(&claim, measured, "below 1", offset < 1.0);
        let claim = format!("{link}, 60 s: 95 % intervals of rate and offset");
        coverage_figure(&claim, &self.held, 0.93..=1.0);
    }
}

#[test]
#[ignore = "minutes: cargo xtask campaign clocks"]
fn exponential_jitter_on_the_wireless_link_alone() {
    let mut figures = Figures::default();
    for seed in 1..=80 {
        let session = Session { seed, wireless: EXPONENTIAL, ..Session::default() };
        let [_, model] = clocks(&session.record());
        figures.add(&session, &model);
    }
    figures.record("exponential jitter, 50 ms");
}

#[test]
#[ignore = "minutes: cargo xtask campaign clocks"]
fn slow_lines() {
    for (baud, jitter) in [
        (38_400, "latency=15ms,jitter=50ms"),
        (19_200, "latency=15ms,jitter=50ms"),
        (9600, "latency=15ms,jitter=50ms"),
    ] {
        let wireless: &'static str = format!("baud={baud},{jitter}").leak();
        let mut figures = Figures::default();
        let mut often = 0.0_f64;
        for seed in 1..=20 {
            let session = Session { seed, wireless, ..Session::default() };
            let file = session.record();
            let [_, model] = clocks(&file);
            figures.add(&session, &model);
            // The part of the line that questions take, in the worst second.
            let mut asked = [0; 61];
            for entry in entries(&file) {
                if let Recorded::Sent { role, host_ns, bytes } = entry
                    && role == LinkRole::Wireless
                {
                    asked[(host_ns / 1_000_000_000).min(60) as usize] += bytes.len();
                }
            }
            let most = asked.iter().skip(3).max().copied().unwrap_or_default();
            often = often.max(most as f64 * 10.0 / f64::from(baud));
        }
        figures.record(&format!("{baud} baud, 50 ms jitter"));
        println!(
            "questions take {:.0} % of the line in the worst second after the third",
            100.0 * often
        );
    }
}
