//! The whole loop on a simulated board in virtual time, over the real driver, node and wire.

use wimu_host::ErrorCode;
use wimu_sim::scenario::{Calibration, FirstLight, Outcome};

fn run(seed: u64, calibration: Calibration) -> Outcome {
    FirstLight { seed, calibration }
        .run()
        .unwrap_or_else(|error| panic!("seed {seed}, {calibration:?}: {error}"))
}

fn holds_for_one_board(outcome: &Outcome) {
    let [before, after] = outcome.tilts_rms_mps2();
    assert!(before >= 0.4, "uncalibrated {before} m/s² rms");
    assert!(
        after < 0.005 && before / after >= 50.0,
        "{before} → {after} m/s² rms"
    );
    assert_eq!(outcome.tilts.len(), 10);
    assert_ne!(outcome.pushed.0, 0);
    assert_eq!(outcome.pushed, outcome.after_restart);
    assert_eq!(outcome.boot_counts, [1, 2]);
    // Nobody pushes over the radio without the key, before the board has one and after.
    assert_eq!(outcome.refusals.len(), 3);
    for refusal in &outcome.refusals {
        let code = refusal.as_ref().map(|error| error.code());
        assert_eq!(code, Some(ErrorCode::KeyNeeded), "{refusal:?}");
    }
    println!(
        "a push over 115,200 baud took {:.0} ms",
        outcome.push_s * 1e3
    );
    assert!(outcome.push_s < 0.2, "{}", outcome.push_s);
    for replay in &outcome.replays {
        assert!(replay.is_exact(), "{replay:?}");
        // A restart may cut off samples whose epoch had gone ahead.
        assert!(replay.breaks <= 1, "{replay:?}");
        assert!(replay.corrected_compared > 4000 && replay.navigation_compared > 400);
    }
    assert_eq!(outcome.replays.len(), 4, "two links, two starts");
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn holds_over_100_seeds(calibration: Calibration) {
    let outcomes: Vec<Outcome> = (0..100).map(|seed| run(seed, calibration)).collect();
    for outcome in &outcomes {
        holds_for_one_board(outcome);
    }
    let of = |pick: fn(&Outcome) -> f64| median(outcomes.iter().map(pick).collect());
    let uncalibrated = of(|o| o.slide.uncalibrated_m);
    let calibrated = of(|o| o.slide.calibrated_m);
    let ratio = of(|o| o.slide.uncalibrated_m / o.slide.calibrated_m);
    let zupt = of(|o| o.slide.zupt_m);
    println!(
        "{calibration:?}: slide of 1 m, median of 100: uncalibrated {:.1} mm, calibrated {:.1} mm ({ratio:.0} times), with ZUPT {:.2} mm",
        uncalibrated * 1e3,
        calibrated * 1e3,
        zupt * 1e3
    );
    assert!(ratio >= 20.0, "{ratio}");
    assert!(zupt <= 0.005, "{zupt} m");
}

#[test]
fn six_squared_positions_make_a_hundred_boards_true() {
    holds_over_100_seeds(Calibration::SixPositions);
}

#[test]
fn twelve_poses_by_hand_make_a_hundred_boards_true() {
    holds_over_100_seeds(Calibration::TwelvePoses);
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let calibration = Calibration::TwelvePoses;
    assert_eq!(run(7, calibration).recording, run(7, calibration).recording);
}
