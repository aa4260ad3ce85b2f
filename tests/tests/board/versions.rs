//! A host of wire version 1.

use wimu_link::frame::Frame;
use wimu_link::message::Settings;
use wimu_link::{Deframer, Hello, Kind, WIRE_VERSION};
use wimu_tests::{ROLES, Rig, frame_of, reply_frames};

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
