//! Which pose next: advice, and what it is worth.

use crate::common;

use common::{cross, norm, unit};
use wimu_calib::{Guide, Orientation};

#[test]
fn advice_ends_when_more_poses_change_little_and_leaves_out_what_cannot_be_reached() {
    let mut guide = Guide::default();
    let begin = guide.worth(|_| true);
    assert!((12..25).contains(&begin), "{begin}");
    let upright = |o: Orientation| o.up()[2] >= 0.0;
    for _ in 0..begin {
        let next = guide.next(upright).expect("one can be reached");
        assert!(next.up()[2] >= 0.0);
        guide.take(next.up());
    }
    assert!(guide.worth(upright) <= 3);
    assert!(guide.next(|_| false).is_none() && guide.worth(|_| false) == 0);
    guide.take([f64::NAN; 3]);
    guide.take([0.0; 3]);
    assert!(guide.amplification().is_finite());
}

#[test]
fn instructions_name_the_sides_that_are_down() {
    for orientation in Orientation::ALL {
        let text = orientation.instruction().to_string();
        // "stand it on the corner between +X side, −Y side and −Z side"
        let mut up = [0.0; 3];
        for (k, side) in wimu_calib::Face::SIDES.iter().enumerate() {
            if text.contains(side) {
                up[k / 2] = [-1.0, 1.0][k % 2];
            }
        }
        assert!(norm(cross(unit(up), orientation.up())) < 1e-6, "{text}: {up:?}");
        let along: f64 = (0..3).map(|k| up[k] * orientation.up()[k]).sum();
        assert!(along > 0.0, "{text}: {up:?}");
        assert_eq!(Orientation::ALL[orientation.index()], orientation);
    }
    assert_eq!(
        Orientation::from(wimu_calib::Face::XDown).instruction().to_string(),
        "lay it on its +X side (arrow X down)"
    );
    let sides = ["left", "right", "front", "back", "lid", "bottom"];
    assert_eq!(
        Orientation::ALL[25].instruction_with(&sides).to_string(),
        "stand it on the corner between right, back and bottom"
    );
}
