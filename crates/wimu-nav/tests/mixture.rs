//! What a mixture of filters claims.

use nalgebra::{Matrix1, Rotation3, Vector1};
use wimu_nav::filter::Filter;
use wimu_nav::mixture::Mixture;
use wimu_nav::sensor::{Measurement, Prediction};
use wimu_nav::state::{Block, Layout, Role};

/// x² = value, linearised at a root.
struct Square {
    block: Block<1>,
    value: f64,
    at: f64,
}

impl Measurement for Square {
    fn predict(&self, filter: &Filter) -> Prediction {
        let x = filter.state.get(self.block).x;
        let slope = 2.0 * self.at;
        Prediction::new(
            Vector1::new(self.value - self.at * self.at - slope * (x - self.at)),
            Matrix1::new(0.01),
        )
        .by(self.block, Matrix1::new(slope))
    }
}

fn start(mean: f64) -> (Mixture<2>, Block<1>) {
    let mut layout = Layout::new([0.1; 3], 0.1, 0.1);
    let block = layout.claim(Role::Estimated, [5.0]);
    let mut filter = Filter::new(&layout, Rotation3::identity());
    filter.state.set(block, Vector1::new(mean));
    (Mixture::new(filter), block)
}

fn observe(mixture: &mut Mixture<2>, block: Block<1>, value: f64) {
    mixture.update(10.0, f64::INFINITY, |_, put| {
        for sign in [1.0, -1.0] {
            put(Square { block, value, at: sign * value.sqrt() });
        }
    });
}

#[test]
fn the_sign_of_a_square_stays_open_and_the_moments_are_those_of_both() {
    let (mut mixture, block) = start(0.0);
    observe(&mut mixture, block, 4.0);
    let found: Vec<f64> =
        mixture.components().iter().map(|c| c.filter.state.get(block).x).collect();
    assert_eq!(found.len(), 2);
    assert!(found.iter().all(|x| (x.abs() - 2.0).abs() < 0.01), "{found:?}");
    assert!((mixture.certainty() - 0.5).abs() < 1e-6);
    // 0 ± 2, and the deviation of each.
    let both = mixture.moments();
    let own = mixture.components()[0].filter.covariance(block).x;
    let mean = both.state.get(block).x;
    assert!(mean.abs() < 1e-6, "{mean}");
    let spread = found[0] * found[0];
    assert!((both.covariance(block).x - own - spread).abs() < 1e-6);
}

#[test]
fn the_prior_decides_between_roots_and_components_that_agree_are_merged() {
    let (mut mixture, block) = start(3.0);
    observe(&mut mixture, block, 4.0);
    assert!(mixture.components()[0].filter.state.get(block).x > 1.9);
    assert!(mixture.certainty() > 0.6);
    // Probabilities add to one.
    let sum: f64 = mixture.components().iter().map(|c| c.log_weight.exp()).sum();
    assert!((sum - 1.0).abs() < 1e-9);
    mixture.merge(block, 1.0);
    assert_eq!(mixture.components().len(), 2, "4 apart");
    mixture.merge(block, 1e9);
    assert_eq!(mixture.components().len(), 1);
    assert!((mixture.certainty() - 1.0).abs() < 1e-9);
}

#[test]
fn a_measurement_that_fits_no_hypothesis_changes_nothing() {
    let (mut mixture, block) = start(0.1);
    observe(&mut mixture, block, 4.0);
    let before = mixture.components()[0].filter.state.get(block);
    let innovation =
        mixture.update(10.0, 50.0, |_, put| put(Square { block, value: 1e4, at: 100.0 }));
    assert!(!innovation.unwrap().accepted);
    assert_eq!(mixture.components()[0].filter.state.get(block), before);
    assert!(mixture.update::<Square>(10.0, 50.0, |_, _| ()).is_none());
}
