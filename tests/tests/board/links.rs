//! Links that are slow, stall, or bring rubbish: the board samples on, and the other link is
//! perfect.

use wimu_host::decode::TimedSample;
use wimu_link::frame::FrameError;
use wimu_link::message::{Refusal, Settings, Status, Streams};
use wimu_link::{Answer, Command, Deframer, LinkRole, WIRE_VERSION};
use wimu_sim::board::BoardConfig;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::World;
use wimu_tests::{ROLES, Random, Rig, assert_replays, damage, frame_of, gaps, sensor, who_are_you};

const ROOMY: LinkConfig = LinkConfig { baud: None, transmit_buffer: 1024, receive_buffer: 1024 };

fn other(role: LinkRole) -> LinkRole {
    match role {
        LinkRole::Cable => LinkRole::Wireless,
        _ => LinkRole::Cable,
    }
}

fn rig(cable: LinkConfig, wireless: LinkConfig) -> Rig {
    let config = BoardConfig { cable, wireless, ..BoardConfig::default() };
    Rig::new(config, sensor("rest,hand,slide", World::default(), 21))
}

fn damaged(status: &Status, role: LinkRole) -> u32 {
    let link = match role {
        LinkRole::Cable => status.cable,
        _ => status.wireless,
    };
    link.unwrap().frames_damaged
}

fn shed(status: &Status, role: LinkRole) -> u32 {
    let link = match role {
        LinkRole::Cable => status.cable,
        _ => status.wireless,
    };
    link.unwrap().telemetry_shed
}

/// 1152 bytes every 0.1 s, what 115,200 baud can bring, for 8 s.
fn flood(role: LinkRole, mut rubbish: impl FnMut(&mut Rig) -> Vec<u8>) -> (Rig, Status) {
    let uart = BoardConfig::default();
    let mut rig = rig(uart.cable, uart.wireless);
    // A host has been there: the wireless line's rate is found.
    rig.send(LinkRole::Wireless, &who_are_you());
    rig.run(2.0);
    for _ in 0..80 {
        let mut bytes = Vec::new();
        while bytes.len() < 1152 {
            bytes.extend(rubbish(&mut rig));
        }
        rig.send(role, &bytes);
        rig.run(0.1);
    }
    rig.send(role, &[0]);
    rig.run(2.0);
    let status = rig.status();
    assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
    rig.link(other(role)).assert_perfect();
    assert_eq!(shed(&status, other(role)), 0);
    assert_eq!(damaged(&status, other(role)), 0);
    // Both still answer.
    for role in ROLES {
        let answer = rig.ask(role, Command::GetSettings);
        assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    }
    assert_replays(rig.boot(role));
    (rig, status)
}

#[test]
fn random_bytes_on_one_link_are_counted_and_harm_nothing() {
    for role in ROLES {
        let mut seeded = Random::new(1);
        let (rig, status) = flood(role, |_| seeded.bytes(100));
        assert!(damaged(&status, role) > 100, "{status:?}");
        rig.link(role).assert_perfect();
    }
}

#[test]
fn bytes_without_an_end_of_frame_harm_nothing() {
    for role in ROLES {
        let (rig, status) = flood(role, |_| vec![0x55; 100]);
        assert!(damaged(&status, role) >= 1, "{status:?}");
        rig.link(role).assert_perfect();
    }
}

#[test]
fn damaged_spliced_and_truncated_requests_are_counted_and_none_is_obeyed() {
    for role in ROLES {
        let mut seeded = Random::new(2);
        let mut sent = 0;
        let (mut rig, status) = flood(role, |rig| {
            let wanted = Settings { range_g: 16, ..Settings::default() };
            let mut frame = rig.frame_of(Command::SetSettings(wanted));
            let whole = frame.clone();
            while frame == whole || passes(&frame) {
                damage(&mut seeded, &mut frame);
            }
            sent += 1;
            frame
        });
        assert!(damaged(&status, role) > sent / 4, "{sent}: {status:?}");
        assert_eq!(rig.settings(), Settings::default());
        rig.link(role).assert_perfect();
    }
}

/// Whether a piece of these bytes, between zeros, is an intact frame.
fn passes(bytes: &[u8]) -> bool {
    let mut deframer = Deframer::new();
    let mut ended = bytes.to_vec();
    ended.push(0);
    ended.iter().any(|&byte| matches!(deframer.push(byte), Some(Ok(_))))
}

#[test]
fn unknown_kinds_and_versions_are_counted_and_not_fatal() {
    for role in ROLES {
        let mut seeded = Random::new(3);
        let mut sent = 0;
        let (rig, status) = flood(role, |_| {
            sent += 1;
            let body = seeded.bytes(40);
            match seeded.below(2) {
                0 => frame_of(1 + seeded.below(15) as u8, 5, &body),
                _ => frame_of(WIRE_VERSION, 8 + seeded.below(8) as u8, &body),
            }
        });
        assert!(passes(&frame_of(WIRE_VERSION, 5, b"of this kind and version")));
        let unknown = [frame_of(4, 5, b""), frame_of(WIRE_VERSION, 9, b"")].map(|frame| {
            let mut deframer = Deframer::new();
            frame
                .into_iter()
                .find_map(|byte| deframer.push(byte).map(|found| found.map(|frame| frame.kind)))
        });
        assert!(matches!(
            unknown,
            [
                Some(Err(FrameError::UnknownVersion { version: 4, .. })),
                Some(Err(FrameError::UnknownKind { kind: 9, .. }))
            ]
        ));
        assert!(damaged(&status, role) > sent * 9 / 10, "{sent}: {status:?}");
        rig.link(role).assert_perfect();
    }
}

#[test]
fn intact_frames_with_random_bodies_harm_nothing() {
    for role in ROLES {
        let mut seeded = Random::new(4);
        let (mut rig, _) = flood(role, |_| {
            let length = seeded.below(60);
            let body = seeded.bytes(length);
            frame_of(WIRE_VERSION, 1 + seeded.below(7) as u8, &body)
        });
        assert_eq!(rig.settings(), Settings::default());
        rig.link(role).assert_perfect();
    }
}

#[test]
fn a_host_that_asks_who_is_there_without_end_does_not_disturb_the_other_link() {
    for role in ROLES {
        let (rig, _) = flood(role, |_| who_are_you());
        rig.link(role).assert_perfect();
    }
}

#[test]
fn a_host_that_asks_the_same_without_end_does_not_disturb_the_other_link() {
    for role in ROLES {
        let mut question = None;
        flood(role, |rig| {
            question.get_or_insert_with(|| rig.frame_of(Command::GetSettings)).clone()
        });
        flood(role, |rig| rig.frame_of(Command::GetStatus));
    }
}

fn epochs(rig: &Rig, role: LinkRole) -> Vec<u32> {
    let epochs = rig.boot(role).epochs();
    epochs.iter().map(|mark| mark.epoch.sequence).collect()
}

/// That `some` are of `all`, bit for bit.
fn assert_part_of(some: &[TimedSample], all: &[TimedSample]) {
    for sample in some {
        let found = all.binary_search_by_key(&sample.sequence, |known| known.sequence);
        let known = all[found.unwrap_or_else(|_| panic!("{sample:?} is invented"))];
        assert_eq!(sample.value, known.value);
        assert!(sample.time.0.abs_diff(known.time.0) < 2_000, "{sample:?}");
    }
}

#[test]
fn a_link_of_9600_baud_sheds_the_oldest_telemetry_counts_it_and_keeps_every_epoch() {
    for slow in ROLES {
        let line = LinkConfig { baud: Some(9600), transmit_buffer: 64, ..LinkConfig::default() };
        let configs = ROLES.map(|role| if role == slow { line } else { ROOMY });
        let mut rig = rig(configs[0], configs[1]);
        rig.run(20.0);
        let asked_us = rig.board.now_us();
        let answer = rig.ask(slow, Command::GetSettings);
        assert!(matches!(answer, Answer::Accepted(_)));
        let waited_us = rig.board.now_us() - asked_us;
        assert!(waited_us < 1_500_000, "answers wait for no telemetry");
        let status = rig.status();
        rig.run(3.0);
        rig.link(other(slow)).assert_perfect();
        assert!(shed(&status, slow) > 50, "{status:?}");
        assert_eq!(shed(&status, other(slow)), 0);
        assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));

        let (slow_boot, fast_boot) = (rig.boot(slow), rig.boot(other(slow)));
        let (got, sent) = (epochs(&rig, slow), epochs(&rig, other(slow)));
        assert!(sent.starts_with(&got) && got.len() + 2 >= sent.len());
        assert!(slow_boot.raw().len() > 500, "{}", slow_boot.raw().len());
        assert!(!gaps(slow_boot.raw()).is_empty());
        assert_part_of(slow_boot.raw(), fast_boot.raw());
        assert_part_of(slow_boot.corrected(), fast_boot.corrected());
        assert_replays(slow_boot);
        let statistics = rig.link(slow).record().statistics;
        assert_eq!(statistics.frames_damaged, 0);
        let last = slow_boot.raw()[slow_boot.raw().len() - 1].sequence;
        assert_eq!(
            statistics.raw.received + statistics.raw.missing,
            u64::from(last - slow_boot.raw()[0].sequence) + 1
        );
        // The oldest goes first: what arrives is not older than the queue is long.
        let now_us = rig.board.now_us();
        let newest_us = slow_boot.raw()[slow_boot.raw().len() - 1].time.0;
        assert!(now_us - newest_us < 4_000_000, "{} µs old", now_us - newest_us);
    }
}

#[test]
fn a_host_that_looks_away_for_a_while_misses_samples_but_no_epoch() {
    for stalled in ROLES {
        let mut rig = rig(ROOMY, ROOMY);
        rig.run(3.0);
        rig.listen(stalled, false);
        rig.run(4.0);
        rig.listen(stalled, true);
        rig.run(4.0);
        rig.link(other(stalled)).assert_perfect();
        assert_eq!(epochs(&rig, stalled), epochs(&rig, other(stalled)));
        let status = rig.status();
        assert!(shed(&status, stalled) > 0);
        assert_eq!(shed(&status, other(stalled)), 0);
        assert_part_of(rig.boot(stalled).raw(), rig.boot(other(stalled)).raw());
        assert!(!gaps(rig.boot(stalled).raw()).is_empty());
        assert_replays(rig.boot(stalled));
    }
}

#[test]
fn a_host_that_looks_away_for_long_finds_its_way_back() {
    for stalled in ROLES {
        let mut rig = rig(ROOMY, ROOMY);
        rig.run(3.0);
        rig.listen(stalled, false);
        rig.run(60.0);
        let resumed_us = rig.board.now_us();
        rig.listen(stalled, true);
        rig.run(4.0);
        rig.link(other(stalled)).assert_perfect();
        let status = rig.status();
        assert!(shed(&status, stalled) > 100);
        assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
        let boot = rig.boot(stalled);
        let resumed = boot.raw().iter().filter(|raw| raw.time.0 > resumed_us);
        assert!(resumed.count() > 350);
        assert_part_of(boot.raw(), rig.boot(other(stalled)).raw());
        assert_replays(boot);
        assert_eq!(rig.link(stalled).record().statistics.frames_damaged, 0);
    }
}

#[test]
fn a_line_that_damages_what_the_board_says_never_invents_a_sample() {
    use wimu_host::capture::Link;
    use wimu_host::decode::{Decoder, Event};
    let mut rig = Rig::usual();
    rig.run(15.0);
    let truth = rig.boot(LinkRole::Cable);
    let clean = rig.link(LinkRole::Cable).bytes();
    for seed in 0..60 {
        let mut seeded = Random::new(seed);
        let mut bytes = clean.clone();
        for _ in 0..1 + seeded.below(40) {
            damage(&mut seeded, &mut bytes);
        }
        let mut decoder = Decoder::new();
        let mut record = Link::new(LinkRole::Cable);
        let mut damage = 0;
        for piece in bytes.chunks(1 + seeded.below(100)) {
            decoder.push(0, piece, |arrival| {
                damage += usize::from(matches!(arrival.event, Event::Damaged(_)));
                record.take(&arrival);
            });
        }
        assert_eq!(record.boots.len(), 1);
        let boot = &record.boots[0];
        assert!(damage > 0);
        assert!(boot.raw().len() > truth.raw().len() / 4);
        assert_part_of(boot.raw(), truth.raw());
        assert_part_of(boot.corrected(), truth.corrected());
        let report = wimu_host::replay::verify(boot, 0);
        assert_eq!(report.first_difference, None, "seed {seed}: {report:?}");
    }
}

#[test]
fn each_link_has_its_own_streams_decimation_and_batches() {
    let mut rig = rig(ROOMY, ROOMY);
    rig.run(3.0);
    let usual = rig.settings();
    rig.set(Settings {
        wireless: Streams {
            corrected: false,
            navigation: false,
            batch: 5,
            every: 4,
            ..usual.wireless
        },
        ..usual
    });
    rig.run(8.0);
    rig.set(usual);
    rig.run(5.0);

    rig.link(LinkRole::Cable).assert_perfect();
    let (cable, wireless) = (rig.boot(LinkRole::Cable), rig.boot(LinkRole::Wireless));
    assert_part_of(wireless.raw(), cable.raw());
    assert_part_of(wireless.corrected(), cable.corrected());
    let decimated: Vec<u32> = (wireless.raw().windows(2))
        .filter(|pair| pair[1].sequence - pair[0].sequence == 4)
        .map(|pair| pair[1].sequence)
        .collect();
    assert!((195..210).contains(&decimated.len()), "{decimated:?}");
    assert!(decimated.iter().all(|sequence| sequence % 4 == 0));
    let between = |from: u32, to: u32| move |s: &&TimedSample| (from..to).contains(&s.sequence);
    let range = between(decimated[0], decimated[decimated.len() - 1]);
    assert_eq!(wireless.corrected().iter().filter(range).count(), 0);
    // No sample that was to be sent is missing, and what the device says agrees.
    let statistics = rig.link(LinkRole::Wireless).record().statistics;
    assert_eq!((statistics.raw.missing, statistics.raw.duplicated), (0, 0));
    assert_replays(wireless);
    assert_eq!(shed(&rig.status(), LinkRole::Wireless), 0);
}

#[test]
fn a_decimation_or_batch_length_that_cannot_be_is_refused_with_the_nearest() {
    let mut rig = rig(ROOMY, ROOMY);
    rig.run(1.0);
    let usual = rig.settings();
    let wanted = Settings { wireless: Streams { every: 0, batch: 99, ..usual.wireless }, ..usual };
    let nearest = Settings { wireless: Streams { every: 1, batch: 32, ..usual.wireless }, ..usual };
    assert_eq!(
        rig.ask(LinkRole::Cable, Command::SetSettings(wanted)),
        Answer::Refused(Refusal::UnsupportedSettings { nearest })
    );
}

#[test]
fn requests_that_come_again_are_counted_on_their_link() {
    let mut rig = rig(ROOMY, ROOMY);
    rig.run(1.0);
    let frame = rig.frame_of(Command::GetSettings);
    for _ in 0..4 {
        rig.send(LinkRole::Wireless, &frame);
        rig.run(0.1);
    }
    let status = rig.status();
    assert_eq!(status.wireless.expect("a link").requests_repeated, 3);
    assert_eq!(status.cable.expect("a link").requests_repeated, 0);
}
