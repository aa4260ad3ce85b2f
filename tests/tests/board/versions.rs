//! Ends of wire version 1: a host, and a recording.

use wimu_link::frame::Frame;
use wimu_link::message::{Settings, WireState};
use wimu_link::{Deframer, Hello, Kind, LinkRole, Telemetry, WIRE_VERSION};
use wimu_tests::{Listener, ROLES, Rig, assert_replays, encoded, frame_of, reply_frames};

/// Calls `each` for every undamaged frame.
fn frames(mut bytes: &[u8], mut each: impl FnMut(Frame<'_>)) {
    let mut deframer = Deframer::new();
    while let Some(frame) = deframer.next(&mut bytes) {
        if let Ok(frame) = frame {
            each(frame);
        }
    }
}

#[test]
fn a_host_of_version_1_gets_the_boards_version_and_changes_nothing() {
    for role in ROLES {
        let mut rig = Rig::usual();
        rig.run(1.0);
        let heard = |rig: &Rig| rig.link(role).bytes().len();
        let before = heard(&rig);
        rig.send(role, &frame_of(1, 2, b"WIMU\x06\x01"));
        // Session 9, id 1, no signature, GetSettings; then FactoryReset.
        rig.send(role, &frame_of(1, 5, &[9, 1, 0, 4]));
        rig.send(role, &frame_of(1, 5, &[9, 2, 0, 3]));
        rig.run(0.5);
        let answer = rig.link(role).bytes()[before..].to_vec();
        let mut greetings = Vec::new();
        frames(&answer, |frame| {
            if frame.kind == Kind::Hello {
                let hello = Hello::decode(frame.body).expect("for ever");
                greetings.push(hello.wire_version);
            }
        });
        // Later than its own, so that host names itself as the end to update.
        assert_eq!(greetings, [WIRE_VERSION]);
        assert!(reply_frames(&answer).is_empty());
        assert_eq!(rig.settings(), Settings::default());
        rig.link(role).assert_perfect();
    }
}

/// What firmware of version 1 would have sent.
fn as_version_1(bytes: &[u8]) -> Vec<u8> {
    let mut old = Vec::new();
    frames(bytes, |frame| {
        let mut body = frame.body.to_vec();
        if let (Kind::Telemetry, Ok(Telemetry::Epoch(mut epoch))) =
            (frame.kind, Telemetry::decode(frame.body))
        {
            epoch.state = WireState { revision: 1, ..epoch.state };
            let again = encoded(|line| <Telemetry>::Epoch(epoch).encode(line));
            frames(&again, |frame| body = frame.body.to_vec());
        }
        if frame.kind == Kind::Hello {
            body[5] = 1;
        }
        old.extend(frame_of(1, frame.kind as u8, &body));
    });
    old
}

#[test]
fn a_recording_of_version_1_is_read_and_replayed_bit_for_bit() {
    let mut rig = Rig::usual();
    rig.run(20.0);
    // Answers that a recording is read for.
    rig.status();
    let new = rig.link(LinkRole::Cable);
    let old = Listener::heard(LinkRole::Cable, &as_version_1(&new.bytes()));
    old.assert_perfect();
    let ([old], [new]) = (old.boots(), new.boots()) else {
        panic!("one start");
    };
    assert_replays(old);
    assert_eq!(old.raw, new.raw);
    assert_eq!(old.corrected, new.corrected);
    assert_eq!(old.navigation, new.navigation);
    assert!(old.status.is_some() && old.status == new.status);
    assert_eq!(old.epochs.len(), new.epochs.len());
    for (old, new) in old.epochs.iter().zip(&new.epochs) {
        assert_eq!((old.epoch.state.revision, new.epoch.state.revision), (1, 2));
        assert_eq!((old.epoch.sensor, old.epoch.gyroscope), (0, None));
    }
}
