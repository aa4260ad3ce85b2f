//! A live calibration of a simulated sensor that a hand turns.

use crate::common;

use common::{DrawModel as _, G, NINE, Random, parameters};
use wimu_calib::{Gravity, Orientation, Parameter, Phase, Session, multi_position};
use wimu_model::{ErrorModel, SpecificForceMps2};

/// A hand that follows advice, with a sensor of this noise in it.
struct Hand<'a> {
    random: Random,
    truth: &'a ErrorModel,
    noise: f64,
    up: [f64; 3],
}

impl Hand<'_> {
    /// Samples of a turn to `up`, then of holding still.
    fn turn(
        &mut self,
        session: &mut Session,
        up: [f64; 3],
        turning: usize,
        holding: usize,
    ) -> Vec<Phase> {
        let (from, to) = (self.up, common::misplaced(&mut self.random, up, 0.03));
        self.up = to;
        (0..turning + holding)
            .map(|k| {
                let share = (k as f64 / turning.max(1) as f64).min(1.0);
                let shake = if k < turning { 2.0 } else { 0.0 };
                let force = [0, 1, 2].map(|i| {
                    G * (from[i] + share * (to[i] - from[i])) + self.random.normal() * shake
                });
                let mut y = self.truth.distort(SpecificForceMps2(force), None).0;
                for axis in &mut y {
                    *axis += self.random.normal() * self.noise;
                }
                session.push(y)
            })
            .collect()
    }
}

#[test]
fn following_the_advice_gives_a_calibration_at_any_rate_and_noise() {
    for (seed, (rate, noise)) in
        [(10.0, 0.1), (25.0, 0.1), (100.0, 0.08), (100.0, 0.002), (1000.0, 0.3)]
            .into_iter()
            .enumerate()
    {
        let mut random = Random::new(seed as u64);
        let truth = random.model(true);
        let mut session = Session::new(rate, 12);
        let mut hand = Hand { random, truth: &truth, noise, up: [0.0, 0.0, 1.0] };
        let mut captured = 0;
        while let Some(next) = session.next() {
            let turning = (0.7 * rate) as usize;
            let phases = hand.turn(&mut session, next.up(), turning, (3.5 * rate) as usize);
            let taken: Vec<&Phase> =
                phases.iter().filter(|phase| matches!(phase, Phase::Captured { .. })).collect();
            assert_eq!(taken, [&Phase::Captured { pose: captured }], "{rate} Hz");
            // In this order: motion, stillness, taken, waiting for motion or done.
            let place = |wanted: fn(&Phase) -> bool| phases.iter().rposition(wanted);
            let moving = place(|p| matches!(p, Phase::WaitingForRest));
            let collecting = place(|p| matches!(p, Phase::Collecting { .. }));
            assert!(moving < collecting, "{moving:?} {collecting:?}");
            captured += 1;
            let last = phases.last().copied();
            let expected = if captured == 12 { Phase::Done } else { Phase::WaitingForMotion };
            assert_eq!(last, Some(expected));
        }
        assert_eq!(captured, 12);
        let gravity = Gravity::new(G, 0.0).expect("gravity");
        let estimate = multi_position(session.poses(), gravity, NINE).expect("answer");
        let error = (0..3)
            .map(|i| (parameters(&estimate.model)[i] - parameters(&truth)[i]).powi(2))
            .sum::<f64>()
            .sqrt();
        let most = 6.0 * noise / (3.0 * rate).sqrt() + 0.001;
        assert!(error < most, "{rate} Hz: {error} {most}");
    }
}

#[test]
fn what_cannot_be_reached_is_skipped_and_a_pose_is_not_taken_twice() {
    let truth = ErrorModel::default();
    let mut session = Session::new(100.0, 8);
    let first = session.next().expect("advice");
    session.skip();
    let second = session.next().expect("other advice");
    assert_ne!(first, second);
    let mut hand = Hand { random: Random::new(5), truth: &truth, noise: 0.01, up: [0.0, 0.0, 1.0] };
    hand.turn(&mut session, second.up(), 50, 300);
    assert_eq!(session.poses().len(), 1);
    let held = session.poses()[0].samples;
    // A knock, then the same again.
    let up = hand.up;
    hand.turn(&mut session, up, 30, 300);
    assert_eq!(session.poses().len(), 1);
    assert!(held > 200);
    for orientation in Orientation::ALL {
        hand.turn(&mut session, orientation.up(), 50, 300);
    }
    // No more than are wanted.
    assert_eq!((session.poses().len(), session.next()), (8, None));
    for _ in 0..26 {
        session.skip();
    }
    assert_eq!(session.push([f64::NAN; 3]), Phase::Done);
    let mut none = Session::new(f64::NAN, 0);
    assert_eq!(none.push([0.0, 0.0, G]), Phase::Done);
}

#[test]
fn a_removed_pose_is_advised_again_and_its_hold_is_left_out() {
    let truth = ErrorModel::default();
    let mut session = Session::new(100.0, 12);
    assert_eq!(session.undo(), None);
    let mut hand = Hand { random: Random::new(7), truth: &truth, noise: 0.01, up: [0.0, 0.0, 1.0] };
    for _ in 0..3 {
        let next = session.next().expect("advice");
        hand.turn(&mut session, next.up(), 50, 300);
    }
    let (before, spread) = (session.poses().len(), session.guide().sd(Parameter::BiasX));
    let advised = session.next().expect("advice");
    hand.turn(&mut session, advised.up(), 50, 300);
    assert_eq!(session.poses().len(), before + 1);
    assert!(session.guide().sd(Parameter::BiasX) < spread);
    assert!(session.undo().is_some() && session.ignores_hold());
    assert_eq!(session.next(), Some(advised));
    // Held on, it is not captured again, by itself or by hand; the poses before stay as they are.
    let kept = session.poses()[before - 1];
    for _ in 0..300 {
        let noise = 0.01 * hand.random.normal();
        session.push(hand.up.map(|axis| G * axis + noise));
    }
    assert_eq!((session.poses().len(), session.capture()), (before, None));
    assert_eq!(session.poses()[before - 1], kept);
    // After a motion it is.
    hand.turn(&mut session, [1.0, 0.0, 0.0], 50, 300);
    hand.turn(&mut session, advised.up(), 50, 300);
    assert_eq!(session.poses().len(), before + 2);
    assert!(!session.ignores_hold());
    // More poses than were wanted at first.
    session.want(before + 2);
    assert_eq!(session.next(), None);
    session.want(16);
    assert!(session.next().is_some());
}

#[test]
fn a_person_may_take_a_pose_before_it_is_long_enough_by_itself_but_none_twice() {
    let mut session = Session::new(100.0, 4);
    assert_eq!(session.capture(), None, "nothing is held yet");
    let mut noise = 0.01;
    let mut hold = |session: &mut Session, up: [f64; 3], samples: u32| {
        let mut last = Phase::WaitingForRest;
        for k in 0..50 + samples {
            noise = -noise;
            let wild = if k < 50 { f64::from(k % 7) } else { 0.0 };
            last = session.push(up.map(|axis| 9.80665 * axis + wild + noise));
        }
        last
    };
    let phase = hold(&mut session, [0.0, 0.0, 1.0], 100);
    assert!(matches!(phase, Phase::Collecting { .. }), "{phase:?}");
    assert_eq!(session.capture(), Some(0));
    assert_eq!(session.capture(), None, "it is taken");
    // It goes on to become better, and is not taken again by itself.
    let taken = session.poses()[0].samples;
    assert_eq!(hold(&mut session, [0.0, 0.0, 1.0], 0), Phase::WaitingForRest);
    assert_eq!(session.capture(), None, "it moves");
    let phase = hold(&mut session, [0.0, 0.0, 1.0], 300);
    assert_eq!(phase, Phase::WaitingForMotion);
    assert_eq!(session.capture(), None, "the same again");
    assert_eq!((session.poses().len(), session.poses()[0].samples), (1, taken));
    hold(&mut session, [1.0, 0.0, 0.0], 100);
    assert_eq!(session.capture(), Some(1));
}
