//! The advice of a calibration on the next pose.

use wimu_calib::{Gravity, MultiPosition, Pose, multi_position};
use wimu_host::calibration::{CalibrateOptions, calibrate};
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Random, figure, trials};

const G: f64 = 9.80665;

fn sensor(random: &mut Random) -> ErrorModel {
    let mut terms = ErrorTerms::default();
    for row in 0..3 {
        terms.bias_mps2[row] = random.within(0.3);
        terms.matrix[row][row] += random.within(0.03);
        for column in 0..row {
            terms.matrix[row][column] = random.within(0.02);
        }
    }
    ErrorModel::new(terms).unwrap()
}

/// The first pose that a calibration of these pose means, m/s², asks for; any where it asks for none.
fn advice(poses: &[[f64; 3]]) -> [f64; 3] {
    let mut recording = Recording::new("poses");
    let mut info = TrackInfo::new("poses", Quantity::SpecificForce, Unit::Si);
    info.timeless = true;
    let track = recording.track(info);
    (0..).zip(poses).for_each(|(time, pose)| recording.row(track, time, pose));
    let samples = recording.samples(Selection { accelerometer: None, poses: true }).unwrap();
    let report = calibrate(&samples, &CalibrateOptions::default()).unwrap();
    report.next_poses.first().map_or([1.0, 0.0, 0.0], |next| next.up())
}

#[test]
fn twelve_poses_by_the_first_advice_each_time_predict_as_well_as_twenty_random_ones() {
    let sensors = trials(1000) as u64;
    let (mut guided, mut random, mut better) = (0.0, 0.0, 0);
    // Sum of the squared differences of the mean squares.
    let mut squares = 0.0;
    for seed in 0..sensors {
        let mut chance = Random::new(seed);
        let sensor = sensor(&mut chance);
        let held = |chance: &mut Random, up: [f64; 3]| {
            let output = sensor.distort(SpecificForceMps2(up.map(|c| c * G)), None).0;
            output.map(|y| y + 0.003 * chance.normal())
        };
        let mut poses = vec![held(&mut chance, [0.0, 0.0, 1.0])];
        while poses.len() < 12 {
            let up = advice(&poses);
            // As a person puts it down: 3° (1 σ).
            let up = up.map(|c| c + 0.05 * chance.normal());
            let norm = up.iter().map(|c| c * c).sum::<f64>().sqrt();
            poses.push(held(&mut chance, up.map(|c| c / norm)));
        }
        let unseen: Vec<Pose> = (0..100)
            .map(|_| chance.direction())
            .map(|up| Pose::from_mean(sensor.distort(SpecificForceMps2(up.map(|c| c * G)), None).0))
            .collect();
        let score = |poses: &[[f64; 3]]| {
            let gravity = Gravity::new(G, 0.0).unwrap();
            let poses: Vec<Pose> = poses.iter().copied().map(Pose::from_mean).collect();
            let estimate = multi_position(&poses, gravity, MultiPosition::default()).ok()?;
            let squares = unseen.iter().map(|pose| estimate.residual_mps2(pose).powi(2));
            Some(1e6 * squares.sum::<f64>() / 100.0)
        };
        let twenty: Vec<_> = (0..20)
            .map(|_| {
                let up = chance.direction();
                held(&mut chance, up)
            })
            .collect();
        let one = score(&poses).expect("guided poses are never refused");
        let Some(other) = score(&twenty) else {
            continue;
        };
        guided += one;
        random += other;
        squares += (one - other).powi(2);
        better += u64::from(one < other);
    }
    let n = sensors as f64;
    let difference = (guided - random) / n;
    let se = (squares / n - difference.powi(2)).sqrt() / n.sqrt();
    println!(
        "better with {better} of {sensors}; difference of the squares {difference:.2} ± {se:.2}"
    );
    let [guided, random] = [guided, random].map(|sum| (sum / n).sqrt());
    figure(
        "12 poses by the advice, unseen orientations, mm/s² rms",
        format!("{guided:.3}"),
        &format!("20 random: {random:.3}"),
        difference <= 2.0 * se,
    );
    assert!(difference <= 2.0 * se, "{difference} ± {se}");
}
