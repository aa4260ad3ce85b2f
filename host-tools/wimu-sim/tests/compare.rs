//! Both links of a simulated board recorded at once, in virtual time, with faults on the wireless
//! one: what the comparison says against what the simulator knows.

use crate::session;

use session::*;
use wimu_host::Code;
use wimu_host::compare::Comparison;
use wimu_host::decode::{Decoder, Event};
use wimu_host::mcap_file::Recorded;
use wimu_link::{Deframer, Hello, Kind, LinkRole, MAX_FRAME};
use wimu_sim::faults::LinkFaults;
use wimu_testkit::{Coverage, Lane, coverage_figure, figure};

/// The sensor at ±2 g, high resolution: 1024 LSB/g.
const LSB_MPS2: f64 = 9.80665 / 1024.0;

#[test]
fn every_sample_that_a_bad_link_lost_is_counted_and_none_is_wrong() {
    let session = Session::default();
    let found = compared(&session.record()).unwrap();
    let [cable, wireless] = &found.links;

    figure(
        "samples over a bad link that differ from the cable's",
        format!("{} of {}", found.pairs - found.identical, found.pairs),
        "none",
        found.identical == found.pairs,
    );
    let missed = wireless.lost + wireless.before + wireless.under_way;
    figure(
        "samples of the cable that a bad link brought or counted as lost",
        format!("{} of {}", wireless.delivered + missed, cable.delivered),
        "all",
        wireless.delivered + missed == cable.delivered,
    );
    assert_eq!(found.identical, found.pairs);
    assert_eq!((cable.lost, cable.missing_on_both, cable.damaged), (0, 0, 0));
    assert!(wireless.lost > 300 && wireless.damaged > 50);
    assert_eq!(wireless.missing_on_both, 0);
    all_accounted_for(&found);
    assert_eq!(wireless.delivered, found.pairs);
    assert!((15.0..120.0).contains(&wireless.latency.median_ms), "{wireless:?}");
    assert!(wireless.latency.max_ms > 2500.0 && cable.latency.max_ms < 30.0);
    let user = wireless.by_arrival.unwrap();
    assert!(user.rms_mps2 > 0.05, "{user:?}");
}

#[test]
fn bias_and_scale_of_the_other_unit_are_found_and_removed_to_one_lsb() {
    // Errors of bias, m/s², and scale factor; what is left, LSB rms.
    let (mut most, mut left) = ([0.0_f64; 2], 0.0_f64);
    for (seed, faults) in
        [(1, "bias=12/-8/5mg,scale=0.4/-0.3/0.2%"), (2, "bias=-60/80/-31mg,scale=-3/2.5/4%")]
    {
        let session = Session { seed, wireless: faults, seconds: 40.0, ..Session::default() };
        let truth = faults.parse::<LinkFaults>().unwrap().values.unwrap();
        let found = compared(&session.record()).unwrap();
        let values = found.values.unwrap();
        for (axis, found) in values.axes.iter().enumerate() {
            let line = found.line.expect("a hand moves every axis");
            let bias = line.bias_mps2 - truth.bias_mps2[axis];
            let scale = line.scale - 1.0 - truth.scale[axis];
            most = [most[0].max(bias.abs()), most[1].max(scale.abs())];
            left = left.max(found.rms_after_mps2 / LSB_MPS2);
            println!(
                "axis {axis}: bias wrong by {bias:+.6} (2 sd {:.6}) m/s², scale by {scale:+.7} (2 sd {:.7}), apart {:?} LSB, then {:.4} m/s² rms",
                2.0 * line.bias_sd_mps2,
                2.0 * line.scale_sd,
                found.max_before_lsb,
                found.rms_after_mps2
            );
            assert!(bias.abs() <= 3.0 * line.bias_sd_mps2, "{axis}: {bias} {line:?}");
            assert!(scale.abs() <= 3.0 * line.scale_sd, "{axis}: {scale} {line:?}");
            assert!(found.max_before_lsb > Some(10));
            assert!(found.rms_after_mps2 < LSB_MPS2, "{found:?}");
        }
    }
    figure(
        "bias and scale between links: errors, m/s² and ppm",
        format!("{:.4} and {:.1}", most[0], most[1] * 1e6),
        "–",
        true,
    );
    figure("difference left between links, LSB rms", format!("{left:.2}"), "below 1", left < 1.0);
}

#[test]
fn a_missing_link_is_named_and_so_are_other_boards_and_no_overlap() {
    let session = Session { wireless: "none", seconds: 8.0, ..Session::default() };
    let both = session.record();
    let all = entries(&both);
    let refusal = |entries: &[Recorded]| {
        let error = compared(&file(entries)).unwrap_err();
        assert_eq!((error.code, error.exit_code()), (Code::DataRefused, 3));
        error.text.clone()
    };
    for (kept, missing) in [(LinkRole::Cable, "wireless"), (LinkRole::Wireless, "cable")] {
        let only: Vec<_> = all.iter().filter(|e| e.role() == kept).cloned().collect();
        assert!(refusal(&only).contains(&format!("the {missing} link is missing")));
    }
    // The cable of the first seconds, the wireless link of the last.
    let apart = |entry: &&Recorded| {
        (entry.host_ns() < 3_000_000_000) == (entry.role() == LinkRole::Cable)
            || entry.host_ns() < 300_000_000
    };
    let early = |entry: &Recorded| entry.host_ns() < 300_000_000;
    let apart: Vec<_> = all.iter().filter(apart).cloned().collect();
    let apart: Vec<_> = apart
        .into_iter()
        .filter(|entry| !(early(entry) && entry.role() == LinkRole::Wireless))
        .collect();
    assert!(refusal(&apart).contains("no sample in common"));
    let other = Session { device_id: 0xabcd, ..session };
    let cable = all.iter().filter(|e| e.role() == LinkRole::Cable).cloned();
    let stranger = entries(&other.record());
    let wireless = stranger.into_iter().filter(|e| e.role() == LinkRole::Wireless);
    let mut mixed: Vec<_> = cable.chain(wireless).collect();
    mixed.sort_by_key(Recorded::host_ns);
    assert!(refusal(&mixed).contains("000000000000abcd"));
}

#[test]
fn a_restart_in_the_middle_and_entries_out_of_order_are_taken_as_they_are() {
    let session = Session {
        seconds: 24.0,
        restart_at: Some(12.0),
        wireless: "baud=115200,loss=3%,latency=15ms,jitter=20ms",
        ..Session::default()
    };
    let recording = session.record();
    let found = compared(&recording).unwrap();
    assert_eq!((found.starts, found.identical), (2, found.pairs));
    assert_eq!(found.links[0].lost, 0, "{:?}", found.links[0]);
    assert!(found.pairs > 1900 && found.links[1].lost > 5, "{:?}", found.links);
    // The links' entries changed places by up to half a second; each link keeps its own order.
    let mut mixed = entries(&recording);
    mixed.sort_by_key(|entry| {
        entry.host_ns() + u64::from(entry.role() == LinkRole::Cable) * 500_000_000
    });
    let again = compared(&file(&mixed)).unwrap();
    assert_eq!((again.pairs, again.identical), (found.pairs, found.identical));
    let lost = |found: &Comparison| found.links.clone().map(|link| link.lost);
    assert_eq!(lost(&again), lost(&found));
    // One link's entries out of order: never a wrong pair, and no panic.
    let mut shuffled = entries(&recording);
    for pair in shuffled.chunks_exact_mut(7) {
        pair.swap(1, 5);
    }
    if let Ok(found) = compared(&file(&shuffled)) {
        assert_eq!(found.identical, found.pairs);
    }
}

#[test]
fn a_link_that_carries_every_fourth_sample_has_lost_none() {
    let session =
        Session { seconds: 12.0, wireless: "latency=5ms", every: 4, ..Session::default() };
    let found = compared(&session.record()).unwrap();
    let [cable, wireless] = &found.links;
    assert!(cable.delivered > 1100 && wireless.delivered < 330, "{found:?}");
    // A few before the setting changed, all of them.
    assert!(found.pairs + 40 > cable.delivered / 4, "{}", found.pairs);
    assert_eq!(found.identical, found.pairs);
    assert_eq!((cable.lost, wireless.lost), (0, 0));
    assert_eq!(wireless.missing_on_both, 0, "{wireless:?}");
}

#[test]
fn what_a_silent_link_did_not_bring_is_lost_at_either_end_of_a_start() {
    let session = Session {
        seconds: 24.0,
        restart_at: Some(12.0),
        wireless: "latency=5ms",
        ..Session::default()
    };
    let recording = entries(&session.record());
    // Until the end; before and over the restart; the whole of the second start.
    for silence in [8.0..30.0, 6.0..15.0, 12.0..30.0] {
        let is_heard = |entry: &&Recorded| {
            let seconds = entry.host_ns() as f64 * 1e-9;
            entry.role() == LinkRole::Cable || !silence.contains(&seconds)
        };
        let heard: Vec<_> = recording.iter().filter(is_heard).cloned().collect();
        let found = compared(&file(&heard)).unwrap();
        let [cable, wireless] = &found.links;
        assert_eq!((cable.lost, found.identical), (0, found.pairs));
        assert!(wireless.lost > 500, "{silence:?}: {wireless:?}");
        all_accounted_for(&found);
    }
    // Opened, and silent at the first.
    let is_heard = |entry: &&Recorded| match entry {
        Recorded::Received(heard) => heard.role == LinkRole::Cable || heard.host_ns > 9_000_000_000,
        _ => true,
    };
    let heard: Vec<_> = recording.iter().filter(is_heard).cloned().collect();
    let found = compared(&file(&heard)).unwrap();
    let wireless = &found.links[1];
    assert!(wireless.lost > 850, "{wireless:?}");
    all_accounted_for(&found);
}

/// Every sample of the cable is in one of the wireless link's figures.
fn all_accounted_for(found: &Comparison) {
    let [cable, wireless] = &found.links;
    let missed = wireless.lost + wireless.before + wireless.under_way;
    assert_eq!(wireless.delivered + missed, cable.delivered, "{wireless:?}");
    // A batch, and a slow link's five seconds.
    assert!(wireless.under_way <= 516, "{wireless:?}");
}

#[test]
fn a_late_wireless_link_connected_first_charges_the_cable_nothing() {
    const WIRELESS_FIRST: [LinkRole; 2] = [LinkRole::Wireless, LinkRole::Cable];
    for (wireless, links) in [
        ("latency=300ms", &WIRELESS_FIRST),
        ("latency=700ms", &WIRELESS_FIRST),
        ("baud=115200,latency=400ms,jitter=200ms", &WIRELESS_FIRST),
        ("latency=700ms", &ROLES),
    ] {
        let session = Session { wireless, links, seconds: 12.0, ..Session::default() };
        let recording = session.record();
        // As recorded, and by a host's clock that began while the first samples were under way.
        let mut later = entries(&recording);
        let first_ns = later.iter().map(Recorded::host_ns).min().unwrap();
        later.iter_mut().for_each(|entry| match entry {
            Recorded::Received(heard) => heard.host_ns -= first_ns,
            Recorded::Sent { host_ns, .. }
            | Recorded::Lost { host_ns, .. }
            | Recorded::Connected { host_ns, .. }
            | Recorded::Damaged { host_ns, .. } => *host_ns -= first_ns,
        });
        let late = compared(&file(&later)).unwrap();
        let lost = late.links.clone().map(|link| link.lost);
        assert_eq!(lost, [0, 0], "{wireless}: {:?}", late.links);
        let found = compared(&recording).unwrap();
        let lost = found.links.clone().map(|link| link.lost);
        assert_eq!(lost, [0, 0], "{wireless}: {:?}", found.links);
        assert!(found.links.iter().all(|link| link.bursts.is_empty()));
    }
}

/// The same recording, what a link brought frame by frame.
fn framed(recording: &[u8]) -> Vec<Recorded> {
    let mut waiting = [Vec::new(), Vec::new()];
    let mut anew = Vec::new();
    for entry in entries(recording) {
        let Recorded::Received(mut heard) = entry else {
            anew.push(entry);
            continue;
        };
        let waiting: &mut Vec<u8> = &mut waiting[usize::from(heard.role == LinkRole::Cable)];
        waiting.append(&mut heard.bytes);
        let ends = waiting.iter().rposition(|byte| *byte == 0);
        let whole: Vec<u8> = waiting.drain(..ends.map_or(0, |end| end + 1)).collect();
        for frame in whole.split_inclusive(|byte| *byte == 0) {
            heard.bytes = frame.to_vec();
            anew.push(Recorded::Received(heard.clone()));
        }
    }
    anew
}

/// The same recording with other boot counts: the `n`th start of the device has that of `count`.
fn counted_anew(recording: &[u8], count: impl Fn(u32) -> u32) -> Vec<u8> {
    let mut anew = framed(recording);
    for entry in &mut anew {
        let Recorded::Received(heard) = entry else {
            continue;
        };
        let mut deframer = Deframer::new();
        let mut rest = &heard.bytes[..];
        let mut hello = match deframer.next(&mut rest) {
            Some(Ok(frame)) if frame.kind == Kind::Hello => Hello::decode(frame.body).unwrap(),
            _ => continue,
        };
        hello.boot_count = count(hello.boot_count);
        let mut frame = [0; MAX_FRAME];
        let length = hello.encode(&mut frame).unwrap();
        heard.bytes = frame[..length].to_vec();
    }
    file(&anew)
}

#[test]
fn starts_with_the_same_boot_count_are_told_apart() {
    let session = Session {
        seconds: 36.0,
        restart_at: Some(15.0),
        wireless: "baud=115200,loss=2%,latency=15ms,jitter=20ms",
        ..Session::default()
    };
    let recording = session.record();
    let truth = compared(&recording).unwrap();
    assert_eq!(truth.starts, 2);
    // The store cannot be read; it was erased; it counts on.
    for count in [|_| 0, |_| 1, |n| n + 6] {
        let found = compared(&counted_anew(&recording, count)).unwrap();
        assert_eq!((found.starts, found.identical), (2, found.pairs));
        assert_eq!(found.pairs, truth.pairs);
        for (link, truth) in found.links.iter().zip(&truth.links) {
            assert_eq!((link.lost, link.delivered), (truth.lost, truth.delivered));
            assert!(link.latency.max_ms < truth.latency.max_ms + 1.0, "{link:?}");
        }
        assert_eq!(found.links[0].lost, 0);
    }
}

#[test]
fn what_the_device_says_of_one_link_on_the_other_counts() {
    let session =
        Session { wireless: "baud=9600,latency=20ms", seconds: 25.0, ..Session::default() };
    let recording = entries(&session.record());
    let found = compared(&file(&recording)).unwrap();
    let [cable, wireless] = &found.links;
    assert_eq!(cable.shed, Some(0));
    assert!(wireless.shed > Some(20), "{wireless:?}");
    // A line of 9600 baud carries 960 bytes a second, and no more samples than came over it.
    assert!(wireless.bytes_per_s < 961.0, "{wireless:?}");
    let delivered = wireless.samples_per_s * wireless.open_s;
    assert!((delivered - wireless.delivered as f64).abs() < 1.0);
    assert!((20.0..26.0).contains(&wireless.open_s), "{wireless:?}");
    // A link that falls silent is open all the same.
    let is_heard =
        |entry: &&Recorded| entry.role() == LinkRole::Cable || entry.host_ns() < 10_000_000_000;
    let heard: Vec<_> = recording.iter().filter(is_heard).cloned().collect();
    let found = compared(&file(&heard)).unwrap();
    assert!(found.links[1].open_s > 20.0 && found.links[1].bytes_per_s < 500.0);
}

#[test]
fn late_samples_are_delivered_and_readings_come_once() {
    let session = Session { seconds: 20.0, wireless: "latency=5ms", ..Session::default() };
    let mut recording = framed(&session.record());
    let at_most = |reach: &[Recorded]| {
        let mut decoder = Decoder::new();
        let mut readings = 0;
        for entry in reach.iter().filter(|entry| entry.role() == LinkRole::Wireless) {
            if let Recorded::Received(heard) = entry {
                decoder.push(heard.host_ns, &heard.bytes, |arrival| {
                    readings += u32::from(matches!(arrival.event, Event::Environment(_)));
                });
            }
        }
        readings
    };
    let readings = at_most(&recording);
    // Every tenth batch comes behind the next of its stream (raw and corrected take turns); then two
    // seconds come again.
    let wireless: Vec<usize> = (0..recording.len())
        .filter(|at| {
            matches!(&recording[*at], Recorded::Received(heard)
                if heard.role == LinkRole::Wireless && is_a_batch(&heard.bytes))
        })
        .collect();
    for pair in wireless[20..wireless.len() - 20].chunks_exact(10) {
        let bytes = |entry: &Recorded| match entry {
            Recorded::Received(heard) => heard.bytes.clone(),
            _ => Vec::new(),
        };
        let [one, two] = [pair[0], pair[2]].map(|at| bytes(&recording[at]));
        for (at, bytes) in [(pair[0], two), (pair[2], one)] {
            if let Recorded::Received(heard) = &mut recording[at] {
                heard.bytes = bytes;
            }
        }
    }
    let found = compared(&file(&recording)).unwrap();
    let wireless = &found.links[1];
    assert!(wireless.late > 50, "{wireless:?}");
    assert_eq!((wireless.lost, wireless.missing_on_both), (0, 0));
    assert!(wireless.bursts.is_empty(), "{wireless:?}");
    all_accounted_for(&found);
    assert_eq!((found.identical, found.pairs), (found.pairs, wireless.delivered));

    let again: Vec<_> = recording
        .iter()
        .filter(|entry| (10_000_000_000..12_000_000_000).contains(&entry.host_ns()))
        .filter_map(|entry| match entry {
            Recorded::Received(heard) if heard.role == LinkRole::Wireless => {
                let mut heard = heard.clone();
                heard.host_ns = 12_000_000_000;
                Some(Recorded::Received(heard))
            }
            _ => None,
        })
        .collect();
    let at = recording.partition_point(|entry| entry.host_ns() <= 12_000_000_000);
    recording.splice(at..at, again);
    assert_eq!(at_most(&recording), readings);
}

fn is_a_batch(bytes: &[u8]) -> bool {
    let mut rest = bytes;
    let mut deframer = Deframer::new();
    let first = deframer.next(&mut rest);
    matches!(first, Some(Ok(frame)) if frame.kind == Kind::Batch) && rest.is_empty()
}

#[test]
fn errors_of_the_other_unit_are_within_their_intervals_and_drawn_bands_over_many_seeds() {
    let mut inside = [Coverage::default(); 2];
    // Of bias and scale factor: points of the bands over time, and those that hold the truth.
    let mut in_band = [Coverage::default(); 2];
    let mut worst = [0.0_f64; 2];
    for seed in 1..=Lane::current().choose([4, 10, 400_u32]) {
        // Spread over ± 60 mg and ± 2 %, down to a thousandth of that.
        let part = |k: u32| f64::from((seed * 7 + k * 13) % 20) / 10.0 - 0.95;
        let size = [1.0, 0.1, 0.001][seed as usize % 3];
        let [bx, by, bz] = [1, 2, 3].map(|k| 60.0 * size * part(k));
        let [sx, sy, sz] = [4, 5, 6].map(|k| 2.0 * size * part(k));
        let faults = format!("bias={bx}/{by}/{bz}mg,scale={sx}/{sy}/{sz}%");
        let truth = faults.parse::<LinkFaults>().unwrap().values.unwrap();
        let session = Session {
            seed: seed.into(),
            wireless: Box::leak(faults.into_boxed_str()),
            seconds: 12.0,
            ..Session::default()
        };
        let found = compared(&session.record()).unwrap();
        let values = found.values.as_ref().expect("a hand moves every axis");
        for (axis, found) in values.axes.iter().enumerate() {
            let Some(line) = found.line else { continue };
            let stored = &values.model;
            assert_eq!(stored.bias_sd_mps2[axis], line.bias_sd_mps2);
            assert_eq!(stored.scale_sd[axis], Some(line.scale_sd));
            let errors = [
                (line.bias_mps2 - truth.bias_mps2[axis]) / line.bias_sd_mps2,
                (line.scale - 1.0 - truth.scale[axis]) / line.scale_sd,
            ];
            for (which, error) in errors.into_iter().enumerate() {
                inside[which].count(error.abs() <= 1.96);
                worst[which] = worst[which].max(error.abs());
            }
            assert!(found.rms_after_mps2 < LSB_MPS2, "{seed}: {found:?}");
        }
        let charts = found.charts();
        let shown = charts.iter().filter(|chart| chart.title.starts_with("Figure 7"));
        for chart in shown {
            let (which, truth) = match chart.y.as_str() {
                "%" => (1, truth.scale.map(|scale| scale * 100.0)),
                _ => (0, truth.bias_mps2.map(|bias| bias * 1e3)),
            };
            for band in &chart.bands {
                let name = &chart.series[band.series].name;
                let axis = ["X", "Y", "Z"].iter().position(|axis| axis == name);
                let axis = axis.expect("a band of an axis");
                if values.axes[axis].line.is_none() {
                    continue;
                }
                for (_, low, high) in &band.points {
                    in_band[which].count((*low..=*high).contains(&truth[axis]));
                }
            }
        }
    }
    println!("worst {worst:.2?} σ");
    // Rounding to whole LSB is taken at its worst.
    let claim = "bias and scale between links: 95 % intervals";
    coverage_figure(claim, &inside, 0.93..=1.0);
    let claim = "bias and scale between links: bands over time hold";
    coverage_figure(claim, &in_band, 0.93..=1.0);
    for (inside, in_band) in inside.into_iter().zip(in_band) {
        inside.assert_can_be(0.93..=1.0, "intervals");
        assert!(in_band.fraction() >= 0.93, "{in_band}");
    }
    assert!(inside[0].total() >= 10, "{inside:?}");
    assert!(worst.iter().all(|worst| *worst < 4.0), "{worst:?}");
}
