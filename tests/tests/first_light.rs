//! The whole loop on a simulated board in virtual time, over the real driver, node and wire.

use wimu_host::Code;
use wimu_sim::board::SensorPart;
use wimu_sim::scenario::{Calibration, FirstLight, Outcome};
use wimu_testkit::{Lane, figure};

fn run(seed: u64, calibration: Calibration) -> Outcome {
    FirstLight { seed, sensor: SensorPart::Lsm303agr, calibration }
        .run()
        .unwrap_or_else(|error| panic!("seed {seed}, {calibration:?}: {error}"))
}

fn holds_for_one_board(outcome: &Outcome) {
    let [before, after] = outcome.tilts_rms_mps2();
    assert!(before >= 0.4, "uncalibrated {before} m/s² rms");
    assert!(after < 0.005 && before / after >= 50.0, "{before} → {after} m/s² rms");
    assert_eq!(outcome.tilts.len(), 10);
    assert_ne!(outcome.pushed.0, 0);
    assert_eq!(outcome.pushed, outcome.after_restart);
    assert_eq!(outcome.boot_counts, [1, 2]);
    // Nobody pushes over the radio without the key, before the board has one and after.
    assert_eq!(outcome.refusals.len(), 3);
    for refusal in &outcome.refusals {
        let code = refusal.as_ref().map(|error| error.code);
        assert_eq!(code, Some(Code::KeyNeeded), "{refusal:?}");
    }
    assert!(outcome.push_s < 0.2, "{}", outcome.push_s);
    for replay in &outcome.replays {
        assert!(replay.is_exact() && replay.breaks == 0, "{replay:?}");
        assert!(replay.corrected_compared > 4000 && replay.navigation_compared > 400);
    }
    assert_eq!(outcome.replays.len(), 4, "two links, two starts");
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn holds_over_many_boards(calibration: Calibration, name: &str) {
    let boards = Lane::current().choose([2, 4, 100]);
    let outcomes: Vec<Outcome> = (0..boards).map(|seed| run(seed, calibration)).collect();
    for outcome in &outcomes {
        holds_for_one_board(outcome);
    }
    let of = |pick: fn(&Outcome) -> f64| median(outcomes.iter().map(pick).collect());
    let uncalibrated = of(|o| o.slide.uncalibrated_m);
    let calibrated = of(|o| o.slide.calibrated_m);
    let ratio = of(|o| o.slide.uncalibrated_m / o.slide.calibrated_m);
    let zupt = of(|o| o.slide.zupt_m);
    let [uncalibrated_mm, calibrated_mm, zupt_mm] =
        [uncalibrated, calibrated, zupt].map(|m| m * 1e3);
    let tilts: Vec<[f64; 2]> = outcomes.iter().map(Outcome::tilts_rms_mps2).collect();
    let [least, most] = [
        tilts.iter().map(|tilt| tilt[0]).fold(f64::INFINITY, f64::min),
        tilts.iter().map(|tilt| tilt[1]).fold(0.0, f64::max),
    ]
    .map(|mps2| mps2 * 1e3);
    println!("{name}: |f| − g of ten tilts at least {least:.0} mm/s² rms before");
    figure(
        &format!("{boards} boards, {name}: |f| − g of tilts, worst, mm/s² rms"),
        format!("{most:.2}"),
        "below 5",
        most < 5.0,
    );
    figure(
        &format!("{name}: slide of 1 m uncalibrated, calibrated, median, mm"),
        format!("{uncalibrated_mm:.0} / {calibrated_mm:.1}"),
        "20 times less",
        ratio >= 20.0,
    );
    figure(
        &format!("{name}: slide of 1 m, calibrated, with ZUPT, median, mm"),
        format!("{zupt_mm:.2}"),
        "at most 5",
        zupt_mm <= 5.0,
    );
    let pushes = || outcomes.iter().map(|outcome| outcome.push_s * 1e3);
    let longest_ms = pushes().fold(0.0, f64::max);
    figure(
        &format!("{name}: signed push over 115,200 baud, session included, ms"),
        format!("{:.0} to {longest_ms:.0}", pushes().fold(f64::INFINITY, f64::min)),
        "below 200",
        longest_ms < 200.0,
    );
    assert!(ratio >= 20.0, "{ratio}");
    // The median of a few boards departs from that of a hundred.
    let most_mm = Lane::current().choose([15.0, 12.0, 5.0]);
    assert!(zupt_mm <= most_mm, "{zupt_mm} mm");
}

#[test]
fn six_squared_positions_make_boards_true() {
    holds_over_many_boards(Calibration::SixPositions, "six positions");
}

#[test]
fn twelve_poses_by_hand_make_boards_true() {
    holds_over_many_boards(Calibration::TwelvePoses, "twelve poses");
}

#[test]
fn six_axes_follow_a_path_of_1_m_with_a_rotation_by_90_degrees() {
    let boards = Lane::current().choose([2, 4, 100]);
    let outcomes: Vec<Outcome> = (1..=boards)
        .map(|seed| {
            let first_light = FirstLight {
                seed,
                sensor: SensorPart::Lsm6dso,
                calibration: Calibration::TwelvePoses,
            };
            first_light.run().unwrap_or_else(|error| panic!("seed {seed}: {error}"))
        })
        .collect();
    outcomes.iter().for_each(holds_for_one_board);
    let of = |pick: &dyn Fn(&Outcome) -> f64| median(outcomes.iter().map(pick).collect());
    let degrees = |k: usize| of(&|o: &Outcome| o.attitude_deg.expect("attitudes")[k]);
    let position_mm = [
        of(&|o| o.slide.uncalibrated_m * 1e3),
        of(&|o| o.slide.calibrated_m * 1e3),
        of(&|o| o.slide.zupt_m * 1e3),
    ];
    let [uncalibrated, calibrated, zupt] = position_mm;
    let attitude = [0, 1, 2].map(degrees);
    figure(
        &format!(
            "{boards} boards, six axes: 1 m with a rotation by 90°, uncalibrated, calibrated, with ZUPT, median, mm"
        ),
        format!("{uncalibrated:.0} / {calibrated:.1} / {zupt:.1}"),
        "calibrated below 150, with ZUPT below 50",
        calibrated < 150.0 && zupt < 50.0,
    );
    figure(
        "six axes: attitude after it, uncalibrated, calibrated, with ZUPT, median, °",
        format!("{:.2} / {:.2} / {:.2}", attitude[0], attitude[1], attitude[2]),
        "calibrated below 0.3",
        attitude[1] < 0.3 && attitude[2] < 0.3,
    );
    assert!(calibrated < 150.0 && zupt < 50.0, "{position_mm:?} mm");
    assert!(attitude[1] < 0.3 && attitude[2] < 0.3, "{attitude:?}°");
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let calibration = Calibration::TwelvePoses;
    assert_eq!(run(7, calibration).recording, run(7, calibration).recording);
}
