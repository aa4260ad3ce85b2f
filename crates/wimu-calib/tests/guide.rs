//! Which pose next: advice, and what it is worth.

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
    assert!(guide.worth(upright) <= 3);
}
