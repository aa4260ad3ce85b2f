//! The board finds out by itself that its calibration no longer holds.

use wimu_link::LinkRole;
use wimu_link::message::{Event, WireParameters};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet};
use wimu_sim::board::{BoardConfig, SensorPart};
use wimu_sim::scenario::{Calibration, FirstLight};
use wimu_sim::scene::World;
use wimu_tests::{Rig, sensor};

/// What the sensor of `seed` was calibrated to, and that off by `error` m/s² along Z.
fn parameters(seed: u64, error: f64) -> WireParameters {
    let calibration = Calibration::TwelvePoses;
    let outcome =
        FirstLight { seed, sensor: SensorPart::Lsm303agr, calibration }.run().expect("calibrated");
    let set = outcome.report.parameters.expect("calibrated");
    let mut terms: ErrorTerms = *set.model.terms();
    terms.bias_mps2[2] += error;
    let model = ErrorModel::new(terms).expect("a model");
    (&ParameterSet { model, ..set }).into()
}

/// What a board of the sensor of `seed` says that rests, moves and rests again and again.
fn said(seed: u64, error: f64) -> Vec<Event> {
    let motion = "rest,tilts,rest,tilts";
    let mut rig = Rig::new(BoardConfig::default(), sensor(motion, World::default(), seed));
    rig.run(1.0);
    super::requests::push(&mut rig, &parameters(seed, error));
    rig.run(100.0);
    let mut events = rig.link(LinkRole::Wireless).events();
    events.retain(|event| matches!(event, Event::CalibrationContradicted { .. }));
    events
}

#[test]
fn a_calibration_that_no_longer_holds_is_told_and_a_good_one_is_not() {
    for seed in 1..3 {
        assert_eq!(said(seed, 0.0), [], "seed {seed}");
        let events = said(seed, 0.4);
        assert!(!events.is_empty(), "seed {seed}");
        let Event::CalibrationContradicted { residual_um_s2, expected_um_s2 } = events[0] else {
            panic!("{events:?}");
        };
        assert!(residual_um_s2.abs() > 50_000 && expected_um_s2 < 60_000, "{events:?}");
    }
}
