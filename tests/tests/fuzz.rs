//! The wire's fuzz bodies on seeded bytes, and a whole board that is talked at.

use wimu_link::message::SetBytes;
use wimu_link::{Answer, Command, WIRE_VERSION};
use wimu_sim::board::BoardConfig;
use wimu_sim::scene::World;
use wimu_testkit::Lane;
use wimu_tests::{
    ROLES, Random, Rig, assert_replays, damage, frame_of, fuzz_once, fuzz_store, sensor,
    who_are_you,
};

#[test]
fn no_bytes_break_the_wire() {
    // The example `fuzz` runs more.
    let mut seeded = Random::new(0xf022);
    for _ in 0..Lane::current().choose([500, 2000, 5000]) {
        fuzz_once(&mut seeded);
    }
}

#[test]
fn no_image_breaks_the_store() {
    let mut seeded = Random::new(0x570e);
    let mut images = 0;
    while images < Lane::current().choose([200, 800, 2000]) {
        images += fuzz_store(&mut seeded);
    }
}

/// What a confused, hostile or broken host may say.
fn anything(seeded: &mut Random, rig: &mut Rig) -> Vec<u8> {
    let length = seeded.below(300);
    match seeded.below(6) {
        0 => seeded.bytes(length),
        1 => vec![seeded.bits() as u8; length],
        2 => frame_of(seeded.below(3) as u8, seeded.bits() as u8, &seeded.bytes(length)),
        3 => {
            let command = [
                Command::GetStatus,
                Command::GetTime,
                Command::GetParameters,
                Command::FactoryReset,
                Command::SetParameters(
                    SetBytes::new(&seeded.bytes(length.min(256))).expect("room"),
                ),
            ][seeded.below(5)];
            let mut frame = rig.frame_of(command);
            for _ in 0..seeded.below(3) {
                damage(seeded, &mut frame);
            }
            frame
        }
        4 => {
            let mut body = vec![seeded.below(4) as u8, seeded.below(256) as u8, 0];
            body.push(seeded.below(8) as u8);
            body.extend(seeded.bytes(length));
            frame_of(WIRE_VERSION, 5, &body)
        }
        _ => who_are_you(),
    }
}

#[test]
fn no_bytes_break_a_board() {
    for seed in 0..Lane::current().choose([2, 12, 100]) {
        let mut seeded = Random::new(seed);
        let source = sensor("rest,hand,slide", World::default(), seed);
        let mut rig = Rig::new(BoardConfig::default(), source);
        for _ in 0..200 {
            let role = ROLES[seeded.below(2)];
            let bytes = anything(&mut seeded, &mut rig);
            rig.send(role, &bytes);
            rig.run(0.001 * seeded.below(100) as f64);
        }
        for role in ROLES {
            rig.send(role, &[0]);
        }
        rig.run(3.0);
        let status = rig.status();
        assert_eq!(status.sensor.missed, 0, "seed {seed}");
        assert!(status.sensor.samples > 500, "seed {seed}: {status:?}");
        for role in ROLES {
            let answer = rig.ask(role, Command::GetSettings);
            assert!(matches!(answer, Answer::Accepted(_)), "seed {seed}");
            assert_replays(rig.boot(role));
            assert_eq!(rig.link(role).boots().len(), 1, "seed {seed}");
        }
    }
}
