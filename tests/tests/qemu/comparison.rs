//! `wimu compare` on both UARTs of the emulated board, the wireless one behind a bad line.

use std::cell::RefCell;

use wimu_host::compare::compare;
use wimu_host::mcap_file::RecordingReader;
use wimu_link::LinkRole;
use wimu_sim::faults::LinkFaults;
use wimu_sim::scenario::Host;
use wimu_sim::scene::World;
use wimu_tests::behind_faults::BehindFaults;
use wimu_tests::qemu::QemuBoard;

use super::{folder, machine, sensor};

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_comparison_of_both_uarts_counts_what_was_lost_and_finds_clock_bias_and_scale() {
    let folder = folder();
    let (source, scene) = sensor("hand", World::default(), 8);
    let board = QemuBoard::start(machine(folder.path()), source);
    let board = board.unwrap_or_else(|error| panic!("{error}"));
    let faults: LinkFaults =
        "noisy,stall=3s@10s,bias=12/-8/5mg,scale=0.4/-0.3/0.2%".parse().expect("faults");
    let board = RefCell::new(BehindFaults::new(board, &faults, 3));
    let mut host = Host::connect(&board, scene).expect("a board");
    // As `wimu record` asks for the board's time.
    let mut next_s = host.now_s();
    while next_s < 40.0 {
        host.cable.ask_time().expect("asked");
        host.wireless.ask_time().expect("asked");
        next_s += 0.06 + 0.005 * next_s.fract();
        host.run_until(next_s).expect("the board goes on");
    }
    let file = host.file().expect("a recording");
    let found = compare(|| RecordingReader::new(&file[..], "qemu"), "qemu").expect("both links");

    let [cable, wireless] = &found.links;
    assert_eq!((cable.lost, cable.missing_on_both, cable.damaged), (0, 0, 0));
    assert_eq!((found.starts, wireless.missing_on_both), (1, 0));
    assert!(wireless.lost > 200 && wireless.damaged > 50, "{wireless:?}");
    // Every sample of the wireless link is a pair, and what is no pair was lost, by its own numbers.
    let recording = host.recording().expect("a recording");
    let [all, some] = [LinkRole::Cable, LinkRole::Wireless].map(|role| {
        let link = recording.link(Some(role)).expect("both links");
        let raw = link.boots[0].raw();
        (link.statistics.raw, raw.len() as u64, raw[0].sequence)
    });
    assert_eq!(found.pairs, some.1);
    // The link's own numbers begin with its first batch, the comparison with its first frame.
    let before_first_batch = u64::from(some.2 - all.2) - wireless.before;
    assert_eq!(wireless.lost, some.0.missing + before_first_batch, "{wireless:?}");
    assert_eq!(all.0.missing, 0);

    // Emulated time is host time, looked at once a millisecond.
    let clock = found.clock.expect("a clock");
    println!("{clock:?}");
    assert!(clock.exchanges > 500, "{clock:?}");
    assert!(clock.rate_ppm.abs() < 20.0, "{clock:?}");
    assert!(clock.offset_sd_ms < 1.0, "{clock:?}");

    let truth = faults.values.expect("values are changed");
    for (axis, found) in found.values.expect("a motion").axes.iter().enumerate() {
        let line = found.line.expect("a hand moves every axis");
        let bias = line.bias_mps2 - truth.bias_mps2[axis];
        let scale = line.scale - 1.0 - truth.scale[axis];
        println!("axis {axis}: bias wrong by {bias:+.6} m/s², scale by {scale:+.7}");
        assert!(bias.abs() <= 3.0 * line.bias_sd_mps2, "{axis}: {bias}");
        assert!(scale.abs() <= 3.0 * line.scale_sd, "{axis}: {scale}");
        assert!(found.rms_after_mps2 < 0.1 * found.rms_before_mps2, "{found:?}");
    }
}
