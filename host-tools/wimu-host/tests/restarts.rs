//! The decoder: which data are of a new start of the device.

use wimu_host::decode::Decoder;
use wimu_model::Counts;

use crate::common::frames::raw;
use crate::decode::{
    course, decode, decode_timed, epoch, hello, hello_at, restarts, samples, samples_of, sequences,
    time,
};

#[test]
fn a_restart_begins_numbers_anew() {
    let mut decoder = Decoder::new();
    let before = [hello(1), epoch(5_000, time(5_000)), samples(5_000, 16)];
    let events = decode(&mut decoder, &before);
    assert_eq!(restarts(&events), []);
    let again = [hello(1), hello(2), samples(0, 16), epoch(16, time(16))];
    let events = decode(&mut decoder, &again);
    assert_eq!(restarts(&events), [Some(2)]);
    assert_eq!(sequences(&events), (0..16).collect::<Vec<_>>());
    // What the start before sent comes again: it was another one all the same.
    let events = decode(&mut decoder, &[hello(1), samples(16, 16)]);
    assert_eq!(restarts(&events), []);
    assert_eq!(sequences(&events), (16..32).collect::<Vec<_>>());
}

#[test]
fn a_restart_without_a_greeting_is_known_by_what_follows_and_its_samples_are_kept() {
    for lost_frames in [0, 1, 3] {
        let mut decoder = Decoder::new();
        let mut frames = vec![(0, hello(1))];
        frames.extend(course(0, 2_000, 0));
        // Up again after 0.7 s.
        let started_us = time(2_000) + 700_000;
        frames.extend(course(0, 1_600, started_us).split_off(lost_frames));
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), [None]);
        // Without its first epoch the new start is known from the second on.
        let heard = if lost_frames == 0 { 0 } else { 96 };
        let expected: Vec<_> = (0..2_000).chain(heard..1_600).collect();
        assert!(sequences(&events) == expected, "{lost_frames} lost");
        // The greeting comes when it is asked for, and tells of no other start.
        let now_us = time(1_600);
        let asked = [
            (started_us + now_us, hello_at(2, now_us)),
            (started_us + time(1_615), samples_of(1, 1_600, 16)),
        ];
        let events = decode_timed(&mut decoder, &asked);
        assert_eq!(restarts(&events), []);
        assert_eq!(sequences(&events), (1_600..1_616).collect::<Vec<_>>());
        // One more start, of which the greeting does arrive.
        let again = [(started_us + 30_000_000, hello_at(3, 1_000))];
        let events = decode_timed(&mut decoder, &again);
        assert_eq!(restarts(&events), [Some(3)]);
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated, raw.late), (0, 0, 0));
    }
}

#[test]
fn a_restart_within_a_silence_is_found_though_its_numbers_pass_the_old_ones() {
    let old = course(0, 576, 0);
    // Up again at 12 s; heard from 15 s on, when it is at number 192.
    let new = course(0, 1_600, 12_000_000).split_off(14);
    let mut decoder = Decoder::new();
    let events = decode_timed(&mut decoder, &[old.clone(), new.clone()].concat());
    assert_eq!(restarts(&events), [None]);
    let expected: Vec<_> = (0..576).chain(192..1_600).collect();
    assert!(sequences(&events) == expected);
    // Asked, it tells at once; so does one that has not started anew.
    let mut decoder = Decoder::new();
    decode_timed(&mut decoder, &[vec![(0, hello(1))], old].concat());
    assert!(decode_timed(&mut decoder, &new[..3]).is_empty() && decoder.is_in_doubt());
    let answer = (new[2].0, hello_at(2, new[2].0 - 12_000_000));
    let events = decode_timed(&mut decoder, &[answer]);
    assert_eq!(restarts(&events), [Some(2)]);
    assert_eq!(sequences(&events), (192..224).collect::<Vec<_>>());
    assert!(decode_timed(&mut decoder, &[(15_100_000, epoch(0, time(0)))]).is_empty());
    assert!(decoder.is_in_doubt());
    let events = decode_timed(&mut decoder, &[(15_200_000, hello_at(2, 3_250_000))]);
    assert!(restarts(&events).is_empty() && !decoder.is_in_doubt());
}

#[test]
fn the_first_greeting_that_is_heard_tells_whether_it_is_of_this_start() {
    let mut decoder = Decoder::new();
    let mut frames = course(0, 2_000, 0);
    let started_us = time(2_000) + 700_000;
    frames.push((started_us + 1_000, hello_at(8, 1_000)));
    frames.extend(course(0, 160, started_us));
    let events = decode_timed(&mut decoder, &frames);
    assert_eq!(restarts(&events), [Some(8)]);
    assert_eq!(sequences(&events).len(), 2_160);
}

#[test]
fn a_late_or_repeated_stretch_is_no_restart_and_nothing_in_it_counts_twice() {
    let clean = course(0, 3_200, 0);
    let numbers: Vec<_> = (0..3_200).collect();
    // An epoch of long ago; the last 2 s once more; both, and then nothing for 4 s and all at once.
    let stale = |at: usize, from: usize, length: usize| {
        let mut frames = clean.clone();
        let (now, _) = frames[at];
        let again = clean[from..from + length].to_vec();
        frames.splice(at..at, again.into_iter().map(|(_, frame)| (now, frame)));
        frames
    };
    let held_up = |mut frames: Vec<(u64, Vec<u8>)>, from: usize| {
        let until = frames[from].0 + 4_000_000;
        for (host_us, _) in &mut frames[from..] {
            *host_us = until.max(*host_us);
        }
        frames
    };
    let cases = [
        (stale(140, 14, 1), 0),
        (stale(140, 126, 14), 192),
        (held_up(stale(140, 126, 14), 154), 192),
        (held_up(stale(140, 14, 1), 141), 0),
    ];
    for (frames, duplicated) in cases {
        let mut decoder = Decoder::new();
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), []);
        assert!(sequences(&events) == numbers);
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated), (0, duplicated));
    }
}

#[test]
fn what_comes_again_behind_a_restart_is_not_the_new_starts() {
    let started_us = time(320) + 700_000;
    let old = course(0, 320, 0);
    let new = course(0, 1_600, started_us);
    // Of each seven frames the first is an epoch.
    let batches = (0..).zip(&old).filter(|(at, _)| at % 7 != 0);
    let again: Vec<_> = batches.map(|(_, (_, frame))| frame).collect();
    let again = &again[again.len() - 8..];
    for at in [0, 5, 12, 14, 20, 26] {
        let now_us = new[at].0;
        let again = again.iter().map(|&frame| (now_us, frame.clone()));
        let mut frames = vec![(0, hello(1))];
        frames.extend(old.iter().cloned());
        frames.push((started_us, hello_at(2, 0)));
        frames.extend(new[..at].iter().cloned());
        frames.extend(again);
        frames.extend(new[at..].iter().cloned());
        let mut decoder = Decoder::new();
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), [Some(2)]);
        let expected: Vec<_> = (0..320).chain(0..1_600).collect();
        assert!(sequences(&events) == expected, "at {at}");
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated, raw.late), (0, 128, 0));
    }
}

#[test]
fn a_start_like_the_one_before_is_another_where_the_link_was_opened_anew() {
    let started_us = time(320) + 700_000;
    let course = course(0, 320, 0);
    let mut decoder = Decoder::new();
    for (start, at_us) in [(1, 0), (2, started_us)] {
        let mut frames = vec![(at_us, hello_at(start, 0))];
        let later = |(us, frame): &(u64, Vec<u8>)| (at_us + us, frame.clone());
        frames.extend(course.iter().map(later));
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(sequences(&events), (0..320).collect::<Vec<_>>());
        decoder.interrupt();
    }
    let raw = decoder.statistics().raw;
    assert_eq!((raw.received, raw.missing, raw.duplicated), (640, 0, 0));
}

#[test]
fn a_sensor_that_is_stuck_gives_the_same_at_each_start_and_none_of_it_is_left_out() {
    let stuck = |first| raw(first, time(first), &[Counts([0, 0, 32767]); 16]);
    let mut decoder = Decoder::new();
    for start in 1..4 {
        let mut frames = vec![hello(start), epoch(0, time(0))];
        frames.extend((0..10).map(|batch| stuck(16 * batch)));
        decode(&mut decoder, &frames);
    }
    let raw = decoder.statistics().raw;
    assert_eq!((raw.received, raw.duplicated), (480, 0));
}
