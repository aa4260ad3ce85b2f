//! Recommended poses.

use wimu_calib::{Face, Guide, Orientation, Pose, Refusal};

use super::{CalibrateOptions, MethodChoice, NextPose, wanted};

/// Largest number of orientations recommended at once.
const MAX_ADVISED: usize = 6;
/// Up to this many more poses than parameters are planned together: chosen one by one they would not be the best set.
const PLANNED_BEYOND: usize = 3;

/// Poses that would resolve this refusal.
pub(super) fn next_poses(
    refusal: &Refusal,
    poses: &[Pose],
    options: &CalibrateOptions,
) -> Vec<NextPose> {
    match *refusal {
        // A repeated orientation adds little: its error may be the same.
        Refusal::NotObservable { .. }
        | Refusal::Confounded { .. }
        | Refusal::PoorPrediction { .. } => advice(poses, options, 1),
        // One that replaces the disturbed pose, and one that identifies it.
        Refusal::PoseContradicted { .. } => advice(poses, options, 2),
        Refusal::PoseMissing { .. } => Face::ALL
            .into_iter()
            .filter(|face| poses.iter().all(|pose| Face::of(pose) != Some(*face)))
            .map(|face| Orientation::from(face).into())
            .collect(),
        Refusal::TooFewPoses { have, need, .. } => {
            advice(poses, options, need.saturating_sub(have))
        }
        _ => Vec::new(),
    }
}

/// The orientations that improve the fit of these poses most: all worthwhile ones, at least `least`.
pub(super) fn advice(poses: &[Pose], options: &CalibrateOptions, least: usize) -> Vec<NextPose> {
    if options.method != MethodChoice::MultiPosition {
        return Vec::new();
    }
    let mut guide = Guide::after(wanted(options), poses);
    let count = guide.worth(|_| true).min(MAX_ADVISED).max(least);
    let enough = wanted(options).fitted().iter().count() + PLANNED_BEYOND;
    let planned = count.max(enough.saturating_sub(poses.len()));
    let next = |remaining| {
        let next = guide.next_of(remaining, |_| true)?;
        guide.take(next.up());
        Some(next.into())
    };
    ((planned - count + 1)..=planned)
        .rev()
        .map_while(next)
        .collect()
}

#[cfg(test)]
mod tests {
    use wimu_calib::{Gravity, Model, multi_position};
    use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};

    use super::*;

    const G: f64 = 9.80665;

    /// Uniform in −1..=1, and of normal deviates the sum of twelve halves of them.
    struct Random(u64);

    impl Random {
        fn uniform(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn normal(&mut self) -> f64 {
            (0..12).map(|_| 0.5 * self.uniform()).sum()
        }

        fn direction(&mut self) -> [f64; 3] {
            loop {
                let v: [f64; 3] = std::array::from_fn(|_| self.uniform());
                let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
                if (0.1..1.0).contains(&norm) {
                    return v.map(|c| c / norm);
                }
            }
        }

        fn sensor(&mut self) -> ErrorModel {
            let mut terms = ErrorTerms::default();
            for row in 0..3 {
                terms.bias_mps2[row] = 0.3 * self.uniform();
                terms.matrix[row][row] += 0.03 * self.uniform();
                for column in 0..row {
                    terms.matrix[row][column] = 0.02 * self.uniform();
                }
            }
            ErrorModel::new(terms).unwrap()
        }
    }

    #[test]
    fn twelve_poses_by_the_first_advice_each_time_predict_as_well_as_twenty_random_ones() {
        const SENSORS: u64 = 300;
        let options = CalibrateOptions::default();
        let (mut guided, mut random, mut better) = (0.0, 0.0, 0);
        // Of the difference of the squares, its square.
        let mut spread = 0.0;
        for seed in 0..SENSORS {
            let mut chance = Random(seed + 1);
            let sensor = chance.sensor();
            let held = |chance: &mut Random, up: [f64; 3]| {
                let output = sensor.distort(SpecificForceMps2(up.map(|c| c * G)), None).0;
                Pose::from_mean(output.map(|y| y + 0.003 * chance.normal()))
            };
            let mut poses = vec![held(&mut chance, [0.0, 0.0, 1.0])];
            while poses.len() < 12 {
                let next = advice(&poses, &options, 1);
                let up = next.first().expect("advice").up;
                // As a person puts it down.
                let up = up.map(|c| c + 0.05 * chance.normal());
                let norm = up.iter().map(|c| c * c).sum::<f64>().sqrt();
                poses.push(held(&mut chance, up.map(|c| c / norm)));
            }
            let unseen: Vec<Pose> = (0..100)
                .map(|_| chance.direction())
                .map(|up| {
                    Pose::from_mean(sensor.distort(SpecificForceMps2(up.map(|c| c * G)), None).0)
                })
                .collect();
            let score = |poses: &[Pose]| {
                let gravity = Gravity::new(G, 0.0).unwrap();
                let estimate = multi_position(poses, gravity, Model::Full9).ok()?;
                let squares = unseen
                    .iter()
                    .map(|pose| estimate.residual_mps2(pose).powi(2));
                Some(1e6 * squares.sum::<f64>() / 100.0)
            };
            let twenty: Vec<Pose> = (0..20)
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
            spread += (one - other).powi(2);
            better += u64::from(one < other);
        }
        let n = SENSORS as f64;
        let difference_sd = (spread / n - ((guided - random) / n).powi(2)).sqrt() / n.sqrt();
        println!(
            "unseen orientations: guided {:.3}, random {:.3} mm/s² rms, better with {better} of {SENSORS}; \
             difference of the squares {:.2} ± {difference_sd:.2}",
            (guided / n).sqrt(),
            (random / n).sqrt(),
            (guided - random) / n
        );
        assert!((guided - random) / n <= 2.0 * difference_sd);
    }
}
