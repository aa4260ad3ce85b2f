//! A bad wireless link: nothing wrong is accepted, everything lost is counted, the cable is perfect.

use wimu_host::decode::TimedSample;
use wimu_link::LinkRole;
use wimu_sim::board::BoardConfig;
use wimu_sim::faults::{Fate, LinkFaults};
use wimu_sim::scene::World;
use wimu_testkit::Lane;
use wimu_tests::{Rig, assert_replays, campaign, gaps, sensor};

fn faults(spec: &str) -> LinkFaults {
    spec.parse().expect("faults")
}

#[test]
fn no_wrong_sample_is_accepted_and_every_lost_one_is_counted() {
    // `cargo run --release -p wimu-tests --example noisy_link` does the same 10⁷ times.
    for seed in 0..Lane::current().choose([1, 4, 4]) {
        let outcome = campaign::run(10_000, &faults("noisy"), seed);
        assert_eq!((outcome.wrong, outcome.restarts), (0, 0), "{outcome:?}");
        assert!(outcome.lost > 10_000, "{outcome:?}");
        let counted = outcome.counted_lost();
        assert_eq!(outcome.lost, counted, "{outcome:?}");
        // All that arrived whole is accepted, and nothing else: the decoder is back with the frame
        // after the one whose zero was lost.
        assert_eq!(outcome.accepted, outcome.samples_whole, "{outcome:?}");
        assert!(outcome.counted.frames >= outcome.faults.frames_intact);
        assert_eq!(outcome.longest_resynchronisation, 1, "{outcome:?}");
    }
}

#[test]
fn spliced_and_repeated_pieces_make_no_wrong_sample_either() {
    for (seed, spec) in [
        (1, "splice=1e-3"),
        (2, "duplicate=1e-3"),
        (3, "noisy,splice=5e-4,duplicate=5e-4,buffer=4096"),
        (4, "loss=50%,burst=300"),
        (5, "bits=0.1"),
    ] {
        let outcome = campaign::run(8_000, &faults(spec), seed);
        assert_eq!(outcome.wrong, 0, "{spec}: {outcome:?}");
        let counted = outcome.counted_lost();
        assert_eq!(outcome.lost, counted, "{spec}: {outcome:?}");
    }
}

#[test]
fn a_board_with_a_bad_wireless_link_is_perfect_on_the_cable() {
    let config =
        BoardConfig { wireless_faults: faults("noisy,stall=3s@10s"), ..BoardConfig::default() };
    let mut rig = Rig::new(config, sensor("rest,hand,slide", World::default(), 8));
    let channels = rig.board.faults(LinkRole::Wireless).expect("faults");
    let to_host = channels.to_host.clone();
    to_host.borrow_mut().log_frames();
    rig.run(60.0);
    let status = rig.status();
    rig.run(4.0);
    rig.link(LinkRole::Cable).assert_perfect();
    assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
    assert_eq!(status.cable.expect("a link").telemetry_shed, 0);

    let (wireless, cable) = (rig.boot(LinkRole::Wireless), rig.boot(LinkRole::Cable));
    let statistics = rig.link(LinkRole::Wireless).record().statistics;
    for (some, all, counted) in [
        (wireless.raw(), cable.raw(), statistics.raw),
        (wireless.corrected(), cable.corrected(), statistics.corrected),
    ] {
        assert_part_of(some, all);
        let lost: u32 = gaps(some).iter().map(|(_, lost)| lost).sum();
        assert!(lost > 100, "{lost}");
        assert_eq!((counted.missing, counted.duplicated), (lost.into(), 0));
        assert_eq!(counted.received, some.len() as u64);
    }
    assert_replays(wireless);
    // What the simulation delivered intact has arrived, whatever was lost around it.
    let frames = to_host.borrow_mut().take_frames();
    let (now_ns, intact) = (rig.board.now_us() * 1000, |fate| fate == Fate::Intact);
    let delivered = frames
        .iter()
        .filter(|frame| intact(frame.fate) && frame.delivered_ns.is_some_and(|at| at <= now_ns));
    assert_eq!(statistics.frames, delivered.count() as u64);
    // The stall: nothing arrives for 3 s, and then what was sent meanwhile.
    let stalled = frames.iter().filter_map(|frame| Some(frame.delivered_ns? - frame.sent_ns)).max();
    assert!((2_900_000_000..3_100_000_000).contains(&stalled.expect("frames")));
}

/// That `some` are of `all`, bit for bit, at their times.
fn assert_part_of(some: &[TimedSample], all: &[TimedSample]) {
    assert!(some.len() > 1000);
    for sample in some {
        let found = all.binary_search_by_key(&sample.sequence, |known| known.sequence);
        let known = all[found.unwrap_or_else(|_| panic!("{sample:?} is invented"))];
        assert_eq!(sample.value, known.value);
        assert!(sample.time.0.abs_diff(known.time.0) < 2_000, "{sample:?}");
    }
}
