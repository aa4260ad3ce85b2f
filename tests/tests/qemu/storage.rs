//! The memory that holds parameters: corrupted, and without power at any word.

use std::cell::RefCell;
use std::fs::{self, File};
use std::io::Read;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use wimu_host::Code;
use wimu_link::LinkRole;
use wimu_link::message::Event as DeviceEvent;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};
use wimu_testkit::{Random, figure};
use wimu_tests::qemu::QemuBoard;

use super::{folder, machine, memory, parameters, sensor};

/// A host on a board that has started in `folder`.
fn started(folder: &Path) -> (RefCell<QemuBoard>, Scene) {
    let (source, scene) = sensor("rest", World::default(), 5);
    let board = QemuBoard::start(machine(folder), source);
    (RefCell::new(board.unwrap_or_else(|error| panic!("{error}"))), scene)
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_corrupted_memory_is_reported_and_taken_for_locked_until_it_is_erased() {
    let folder = folder();
    // 16 MiB, of which the first pages are used: noise, the same in every run.
    let mut bytes = Random::new(1).bytes(64 * 1024);
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
    // A key may have been in it: nobody writes until hands on the board have erased it.
    let refused = host.cable.push_parameters(&parameters(5)).err();
    let refused = refused.expect("refused").code;
    assert_eq!(refused, Code::DeviceRefused);
    board.borrow_mut().machine().memory = Some(folder.path().join("erased"));
    host.restart().expect("it starts again");
    let pushed = host.cable.push_parameters(&parameters(5)).expect("pushed");
    host.restart().expect("it starts again");
    assert_eq!(host.cable.parameters().expect("answered").id, pushed.0);
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
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
        let pushed = host.restart().and_then(|()| host.cable.push_parameters(&sets[new]));
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
    figure(
        "power lost in QEMU at any third word of a push: neither old nor new",
        format!("0 of {}", outcomes[0] + outcomes[1]),
        "none",
        true,
    );
    assert!(outcomes[0] > 20 && outcomes[2] == 1, "{outcomes:?}");
}

/// Kills QEMU `kills` times while it writes a push into a slow flash, at random times within the
/// duration that an uninterrupted push takes on this machine. After each kill it must hold the previous
/// or the new set. Returns how often it held which, and how often the write was unfinished.
fn killed_while_writing(kills: u32) -> ([u32; 2], u32) {
    /// In QEMU some milliseconds.
    const CYCLES: u32 = 3_000_000;
    let folder = folder();
    let (board, scene) = started(folder.path());
    let mut host = Host::connect(&board, scene).expect("a board");
    let sets = [5, 6].map(parameters);
    let ids = sets.map(|set| host.cable.push_parameters(&set).expect("pushed").0);
    let memory = memory(folder.path());
    let mut outcomes = [0; 2];
    let mut unfinished = 0;
    let mut random = Random::new(1);
    board.borrow_mut().machine().slow_flash = Some(CYCLES);
    host.restart().expect("it starts");
    let watched = memory.clone();
    let before = flash(&memory);
    let first = thread::spawn(move || begun(&watched, &before));
    host.cable.push_parameters(&sets[0]).expect("pushed");
    let span = first.join().expect("written").elapsed();
    let mut holds = ids[0];
    for kill in 0..kills {
        board.borrow_mut().machine().slow_flash = Some(CYCLES);
        host.restart().expect("it starts");
        let id = board.borrow().process_id().to_string();
        let delay = span.mul_f64(random.uniform());
        let before = flash(&memory);
        let watched = memory.clone();
        let killer = thread::spawn(move || {
            begun(&watched, &before);
            thread::sleep(delay);
            let killed = Command::new("kill").args(["-9", &id]).status();
            assert!(killed.is_ok_and(|status| status.success()));
        });
        let new = usize::from(holds == ids[0]);
        let pushed = host.cable.push_parameters(&sets[new]);
        killer.join().expect("killed");
        let torn = flash(&memory);
        board.borrow_mut().machine().slow_flash = None;
        host.restart().expect("it starts again");
        let found = host.cable.parameters().expect("answered").id;
        assert!(ids.contains(&found), "{found:08x} after kill {kill}");
        // A set whose push was said to be done is not lost.
        assert!(pushed.is_err() || found == ids[new], "kill {kill}");
        outcomes[usize::from(found == ids[new])] += 1;
        // The same push, if it has to be done again, writes more than what was there.
        let again = host.cable.push_parameters(&sets[new]).expect("pushed").0;
        assert_eq!(again, ids[new]);
        holds = again;
        unfinished += u32::from(pushed.is_err() && flash(&memory) != torn);
    }
    (outcomes, unfinished)
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_machine_killed_while_it_writes_holds_the_old_parameters_or_the_new() {
    let kills = std::env::var("WIMU_KILLS").map_or(8, |kills| kills.parse().expect("a number"));
    let ([old, new], unfinished) = killed_while_writing(kills);
    println!("{unfinished} writes unfinished; the old set {old} times, the new {new}");
    figure(
        "QEMU killed while it writes a push: neither old nor new",
        format!("0 of {kills}"),
        "none",
        true,
    );
    assert!(unfinished * 4 > kills, "{unfinished} of {kills}");
}

/// Waits until the flash in this file is no longer what it was, and says when.
fn begun(path: &Path, before: &[u8]) -> Instant {
    while flash(path) == before {
        thread::sleep(Duration::from_micros(300));
    }
    Instant::now()
}

/// The flash's bytes in the file that keeps it, complemented: an erased bit is 0.
fn flash(path: &Path) -> Vec<u8> {
    let mut bytes = vec![0; 16 << 10];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut bytes));
    read.expect("the board's memory");
    bytes
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn power_lost_while_a_page_is_erased_leaves_the_old_parameters_or_the_new() {
    let folder = folder();
    let (board, scene) = started(folder.path());
    let mut host = Host::connect(&board, scene).expect("a board");
    let sets = [5, 6].map(parameters);
    let ids = sets.map(|set| host.cable.push_parameters(&set).expect("pushed").0);
    // Fills page after page until a push erases one; what was there before it is kept.
    let (before, new) = (0..200)
        .find_map(|push| {
            let before = flash(&memory(folder.path()));
            let new = push % 2;
            host.cable.push_parameters(&sets[new]).expect("pushed");
            let after = flash(&memory(folder.path()));
            let erased = before.iter().zip(&after).any(|(old, now)| old & !now != 0);
            erased.then_some((before, new))
        })
        .expect("no page is ever erased");

    let trial = folder.path().join("trial");
    board.borrow_mut().machine().memory = Some(trial.clone());
    let mut outcomes = [0; 2];
    for words in (0..).step_by(89) {
        // The board that still runs keeps the file that it has open.
        let _ = fs::remove_file(&trial);
        let mut bytes = before.clone();
        bytes.resize(16 << 20, 0);
        fs::write(&trial, bytes).expect("written");
        board.borrow_mut().machine().power_loss_after = Some(words);
        let pushed = host.restart().and_then(|()| host.cable.push_parameters(&sets[new]));
        board.borrow_mut().machine().power_loss_after = None;
        host.restart().expect("it starts again");
        let found = host.cable.parameters().expect("answered").id;
        if pushed.is_ok() {
            assert_eq!(found, ids[new]);
            assert!(words > 1024, "all is done after {words} words, no page erased");
            break;
        }
        assert!(ids.contains(&found), "{found:08x} after {words} words");
        outcomes[usize::from(found == ids[new])] += 1;
        // What the loss left behind is in nobody's way.
        let again = host.cable.push_parameters(&sets[new]).expect("pushed");
        assert_eq!(again.0, ids[new]);
    }
    println!("lost before the new set stood, after: {outcomes:?}");
    figure(
        "power lost in QEMU while a page is erased: neither old nor new",
        format!("0 of {}", outcomes[0] + outcomes[1]),
        "none",
        true,
    );
    assert!(outcomes[0] > 10, "{outcomes:?}");
}
