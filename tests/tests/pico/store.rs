//! What the flash keeps.

use wimu_link::message::{Event, parameter_id};
use wimu_link::{Command, LinkRole};
use wimu_model::{ParameterId, ParameterSet, Sensitivity};
use wimu_tests::ROLES;

use crate::run::{CABLE, cut, happens, request, run, send};

fn set(lsb_per_g: f64) -> ParameterSet {
    let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).expect("in range");
    ParameterSet::uncalibrated(2, sensitivity)
}

/// The two frames that push a set, under ids from `id` on.
fn push(set: &ParameterSet, id: u32) -> [Vec<u8>; 2] {
    let hash = parameter_id(set).0;
    [
        request(id, Command::StageParameters(set.into())),
        request(id + 1, Command::CommitParameters { hash }),
    ]
}

#[test]
#[ignore = "`cargo xtask test --only pico` builds the image and runs it"]
fn a_set_that_was_pushed_is_in_use_after_the_power_was_off() {
    let set = set(16_500.0);
    let [stage, commit] = push(&set, 1);
    let run = run(
        4.0,
        &[
            send(1_000, CABLE, &stage),
            send(1_300, CABLE, &commit),
            happens(2_500, "power"),
        ],
    );
    for role in ROLES {
        let ids: Vec<_> = run
            .boots(role)
            .iter()
            .map(|boot| boot.hello.expect("a hello").parameter_id)
            .collect();
        assert_eq!(ids, [ParameterId::UNCALIBRATED, parameter_id(&set)]);
        let last = run.boots(role).last().expect("a start");
        let epoch = last.epochs.last().expect("an epoch").epoch;
        assert_eq!(epoch.parameter_id(), parameter_id(&set));
    }
}

#[test]
#[ignore = "`cargo xtask test --only pico` builds the image and runs it"]
fn power_that_fails_in_the_middle_of_any_write_leaves_the_old_set_or_the_new_one() {
    let [old, new] = [16_500.0, 16_200.0].map(set);
    let mut outcomes = Vec::new();
    for count in 1.. {
        let ([stage, commit], [stage_new, commit_new]) = (push(&old, 1), push(&new, 3));
        let run = run(
            3.2,
            &[
                send(700, CABLE, &stage),
                send(1_000, CABLE, &commit),
                send(1_500, CABLE, &stage_new),
                cut(1_700, count),
                send(1_800, CABLE, &commit_new),
            ],
        );
        if run.report["resets"] == 0 {
            break;
        }
        let boot = run.boots(LinkRole::Cable).last().expect("a start");
        let hello = boot.hello.expect("a hello");
        assert_eq!(hello.boot_count, 2, "cut {count}");
        let unreadable = boot
            .events
            .iter()
            .any(|(_, event)| *event == Event::StoreUnreadable);
        assert!(!unreadable, "cut {count}: {:?}", boot.events);
        outcomes.push(hello.parameter_id);
    }
    println!("{} cuts", outcomes.len());
    assert!(outcomes.len() >= 3, "{outcomes:?}");
    let (old, new) = (parameter_id(&old), parameter_id(&new));
    assert!(
        outcomes.iter().all(|id| [old, new].contains(id)),
        "{outcomes:?}"
    );
    assert!(outcomes.is_sorted_by_key(|id| *id == new), "{outcomes:?}");
}
