//! Pushes over a bad wireless link: each is applied once or reported failed, and nobody is mistaken
//! about which set is active.

use std::cell::{Cell, RefCell};
use std::time::Duration;

use wimu_host::Code;
use wimu_host::calibration::parameter_id;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::Event;
use wimu_host::transport::Transport;
use wimu_link::LinkRole;
use wimu_link::auth::DeviceKey;
use wimu_link::message::{EpochReason, Settings, Streams};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::scene::World;
use wimu_testkit::{Lane, figure, trials};
use wimu_tests::sensor;

/// 2 % of the bytes lost in runs, 10⁻⁴ of the bits flipped, pieces repeated, stalls of a second.
const FAULTS: &str = "loss=2%,burst=20,bits=1e-4,duplicate=1e-5,stall=1s@10s/60s";

const KEY: DeviceKey = DeviceKey::new([0x33; 32]);

#[derive(Debug, Default)]
struct Counts {
    pushes: u32,
    applied: u32,
    /// Reported failed, and not applied.
    failed: u32,
    /// Reported as unanswered, and applied: the host said that it does not know.
    unknown: u32,
    longest_s: f64,
}

fn options(session: u32) -> ConnectOptions {
    let patience = Duration::from_secs(60);
    ConnectOptions { session: Some(session), patience, ..ConnectOptions::default() }
}

/// A link whose host's clock leaps by an hour, as after a computer's sleep, each time it has been
/// read `leap_every` times.
struct Leaping<T> {
    link: T,
    leap_every: Option<u32>,
    asked: Cell<u32>,
}

impl<T: Transport> Transport for Leaping<T> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> wimu_host::Result<usize> {
        self.link.read(buffer, timeout)
    }

    fn write_all(&mut self, bytes: &[u8]) -> wimu_host::Result<()> {
        self.link.write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.asked.set(self.asked.get() + 1);
        let leaps = self.leap_every.map_or(0, |every| self.asked.get() / every);
        self.link.now() + leaps * Duration::from_secs(3600)
    }
}

fn push_over(faults: &str, leap_every: Option<u32>, seed: u64, pushes: u32) -> Counts {
    let config = BoardConfig {
        wireless_faults: faults.parse().expect("faults"),
        fault_seed: seed,
        ..BoardConfig::default()
    };
    let board = RefCell::new(Board::start(config, sensor("rest", World::default(), seed)));
    let cable = SimLink::new(&board, LinkRole::Cable);
    let mut cable = Client::connect(cable, "cable", options(1)).expect("a board");
    cable.set_key(KEY).expect("set");
    // What is said on the cable is of no matter here, and takes time.
    let quiet = Streams {
        raw: false,
        corrected: false,
        navigation: false,
        environment: false,
        ..Settings::default().cable
    };
    let settings = Settings { cable: quiet, rate_hz: 50, ..Settings::default() };
    cable.set_settings(settings).expect("set");
    let wireless = SimLink::new(&board, LinkRole::Wireless);
    let wireless = Leaping { link: wireless, leap_every: None, asked: Cell::new(0) };
    let mut wireless = Client::connect(wireless, "wireless", options(2)).expect("a board");
    wireless.transport().leap_every = leap_every;
    wireless.use_key(Some(KEY));

    let sensitivity = Sensitivity::from_lsb_per_g(16384.0).expect("the sensor's");
    let mut counts = Counts::default();
    let mut held = cable.parameters().expect("answered").id;
    for push in 0..pushes {
        let terms = ErrorTerms {
            bias_mps2: [f64::from(push + 1) * 1e-5, 0.0, 0.0],
            ..ErrorTerms::default()
        };
        let set = ParameterSet {
            model: ErrorModel::new(terms).expect("a model"),
            ..ParameterSet::uncalibrated(2, sensitivity)
        };
        let id = parameter_id(&set).0;
        let began = board.borrow().now_us();
        let outcome = wireless.push_parameters(&set);
        let took_s = (board.borrow().now_us() - began) as f64 * 1e-6;
        counts.longest_s = counts.longest_s.max(took_s);
        // What the wireless link brought besides is of no matter.
        while wireless.next_event(Duration::ZERO).expect("a link").is_some() {}
        // The truth, by the cable, when what is still under way has arrived.
        let wait_us = if outcome.is_err() { 4_000_000 } else { 100_000 };
        let later = board.borrow().now_us() + wait_us;
        board.borrow_mut().run_until(later);
        let found = cable.parameters().expect("answered").id;
        let mut times_applied = 0;
        while let Some(arrival) = cable.next_event(Duration::ZERO).expect("a link") {
            let is_new = matches!(
                &arrival.event,
                Event::Epoch { epoch, .. } if epoch.reason == EpochReason::Parameters && epoch.parameters == id
            );
            times_applied += u32::from(is_new);
        }
        assert_eq!(times_applied, u32::from(found == id), "push {push}: {outcome:?}");
        counts.pushes += 1;
        match outcome {
            Ok(said) => {
                assert_eq!((said.0, found), (id, id), "push {push}");
                counts.applied += 1;
            }
            Err(error) => {
                assert_eq!(error.code, Code::NoAnswer, "push {push}: {error}");
                if found == id {
                    counts.unknown += 1;
                } else {
                    assert_eq!(found, held, "push {push}");
                    counts.failed += 1;
                }
            }
        }
        held = found;
    }
    counts
}

#[test]
fn a_push_over_a_bad_link_is_applied_once_or_reported_failed() {
    let (boards, pushes) = Lane::current().choose([(1, 20), (1, 120), (10, 1000)]);
    let mut all = Counts::default();
    for seed in 0..boards {
        // Asserts of each push that host and device agree.
        let counts = push_over(FAULTS, None, 10 + seed, pushes);
        println!("seed {seed}: {counts:?}");
        all.pushes += counts.pushes;
        all.applied += counts.applied;
        all.failed += counts.failed;
        all.unknown += counts.unknown;
        all.longest_s = all.longest_s.max(counts.longest_s);
    }
    let Counts { pushes, .. } = all;
    figure(
        "pushes over a bad link applied twice, or reported wrongly",
        format!("0 of {pushes}"),
        "none",
        true,
    );
    figure(
        "pushes over a bad link: applied, reported failed, unanswered",
        format!("{} / {} / {}", all.applied, all.failed, all.unknown),
        "half applied",
        2 * all.applied > pushes,
    );
    assert_eq!(all.applied + all.failed + all.unknown, pushes);
    assert!(2 * all.applied > pushes, "{all:?}");
}

#[test]
fn a_push_over_a_hopeless_link_is_reported_failed_and_nobody_is_mistaken() {
    let counts =
        push_over("loss=12%,burst=30,bits=4e-4,duplicate=1e-4", None, 2, trials(600) as u32);
    println!("{counts:?}");
    assert!(counts.failed + counts.unknown > 0, "{counts:?}");
}

#[test]
fn a_host_clock_that_leaps_costs_a_retry_and_nobody_is_mistaken() {
    let pushes = trials(600) as u32;
    let counts = push_over("", Some(40), 3, pushes);
    println!("{counts:?}");
    assert_eq!(counts.applied, pushes, "{counts:?}");
    // So often that it runs out of tries: it has to say so.
    let counts = push_over("", Some(7), 3, pushes);
    println!("{counts:?}");
    assert!(counts.failed + counts.unknown > 0, "{counts:?}");
    let counts = push_over(FAULTS, Some(50), 4, pushes);
    println!("{counts:?}");
    assert!(2 * counts.applied > pushes, "{counts:?}");
}
