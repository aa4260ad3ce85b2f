//! The memory that holds parameters: corrupted, and without power at any word.

use std::cell::RefCell;
use std::fs;
use std::path::Path;

use wimu_link::LinkRole;
use wimu_link::message::Event as DeviceEvent;
use wimu_sim::qemu::QemuBoard;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};

use super::{folder, machine, memory, parameters, sensor};

/// A host on a board that has started in `folder`.
fn started(folder: &Path) -> (RefCell<QemuBoard>, Scene) {
    let (source, scene) = sensor("rest", World::default(), 5);
    let board = QemuBoard::start(machine(folder), source);
    (
        RefCell::new(board.unwrap_or_else(|error| panic!("{error}"))),
        scene,
    )
}

#[test]
#[ignore = "needs QEMU and the firmware: cargo xtask test --only qemu"]
fn a_corrupted_memory_is_reported_and_can_be_written_again() {
    let folder = folder();
    // 16 MiB, of which the first pages are used: noise, the same in every run.
    let mut state = 1_u32;
    let noise = (0..64 * 1024).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    });
    let mut bytes: Vec<u8> = noise.collect();
    bytes.resize(16 << 20, 0);
    fs::write(memory(folder.path()), bytes).expect("written");

    let (board, scene) = started(folder.path());
    let mut host = Host::connect(&board, scene).expect("a board");
    host.run_until(1.0).expect("the board goes on");
    let recording = host.recording().expect("a recording");
    let cable = recording.link(Some(LinkRole::Cable)).expect("the cable");
    let events = &cable.boots[0].events;
    let unreadable = |(_, event): &(_, DeviceEvent)| *event == DeviceEvent::StoreUnreadable;
    assert!(events.iter().any(unreadable), "{events:?}");
    let pushed = host.cable.push_parameters(&parameters(5)).expect("pushed");
    host.restart().expect("it starts again");
    assert_eq!(host.cable.parameters().expect("answered").id, pushed.0);
}

#[test]
#[ignore = "needs QEMU and the firmware: cargo xtask test --only qemu"]
fn power_lost_at_any_word_of_a_push_leaves_the_old_parameters_or_the_new() {
    let folder = folder();
    let (board, scene) = started(folder.path());
    let mut host = Host::connect(&board, scene.clone()).expect("a board");
    let sets = [5, 6].map(parameters);
    let ids = sets.map(|set| host.cable.push_parameters(&set).expect("pushed").0);
    let mut holds = ids[1];
    let mut outcomes = [0; 3];
    for words in (0..).step_by(3) {
        board.borrow_mut().machine().power_loss_after = Some(words);
        let new = usize::from(holds == ids[0]);
        let pushed = host
            .restart()
            .and_then(|()| host.cable.push_parameters(&sets[new]));
        board.borrow_mut().machine().power_loss_after = None;
        host.restart().expect("it starts again");
        let found = host.cable.parameters().expect("answered").id;
        if pushed.is_ok() {
            assert_eq!(found, ids[new]);
            outcomes[2] += 1;
            break;
        }
        assert!(ids.contains(&found), "{found:08x} after {words} words");
        outcomes[usize::from(found != holds)] += 1;
        holds = found;
    }
    println!("lost before the new set stood, after, never: {outcomes:?}");
    assert!(outcomes[0] > 20 && outcomes[2] == 1, "{outcomes:?}");
}
