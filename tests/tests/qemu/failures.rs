//! Failures of the firmware: panic, overflow of the stack, a task that makes no progress; and safe mode after three of
//! them. In lockstep.

use std::cell::RefCell;
use std::path::Path;

use wimu_host::capture::Boot;
use wimu_link::LinkRole;
use wimu_link::hello::ResetReason;
use wimu_model::ParameterId;
use wimu_sim::board::VirtualBoard;
use wimu_sim::scenario::Host;
use wimu_sim::scene::World;
use wimu_tests::Listener;
use wimu_tests::qemu::QemuBoard;

use super::{folder, machine, parameters, sensor};

fn start(folder: &Path, failure: Option<&str>) -> QemuBoard {
    let (source, _scene) = sensor("rest", World::default(), 5);
    let mut machine = machine(folder);
    machine.failure = failure.map(str::to_owned);
    QemuBoard::start(machine, source).unwrap_or_else(|error| panic!("{error}"))
}

/// Runs the board for `seconds`, then reads what it has sent. With a failure also how the machine has ended.
fn heard(board: &mut QemuBoard, seconds: f64) -> (Boot, Option<String>) {
    let end = board.now_us() + (seconds * 1e6) as u64;
    let ended = board.run_until(end).err().map(|error| error.to_string());
    let mut listener = Listener::heard(LinkRole::Cable, &board.receive(LinkRole::Cable));
    (listener.take_boots().remove(0), ended)
}

/// How a machine with `failure` ends, and the reset reason and fault of the next start.
fn after(failure: &str, seconds: f64) -> (String, ResetReason, String) {
    let folder = folder();
    let mut board = start(folder.path(), Some(failure));
    let (_, ended) = heard(&mut board, seconds);
    board.machine().failure = None;
    board.restart().expect("it starts");
    let hello = heard(&mut board, 1.0).0.hello.expect("a Hello");
    assert!(!hello.safe_mode);
    let fault = hello.fault.map(|fault| fault.to_string());
    let ended = ended.expect("it ends");
    (ended, hello.reset_reason, fault.unwrap_or_default())
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn an_overflow_of_the_stack_is_a_fault_that_the_next_hello_names() {
    let (ended, reason, fault) = after("overflow=1500", 3.0);
    assert!(ended.contains("102"), "{ended}");
    assert_eq!(reason, ResetReason::Fault);
    assert!(fault.starts_with("stack overflow at 0x2000"), "{fault}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_sampler_without_progress_is_restarted_by_the_watchdog() {
    // 12 s without progress and 2 s of the watchdog.
    let (ended, reason, fault) = after("stuck=1500", 16.0);
    assert!(ended.contains("exit status: 4"), "{ended}");
    assert_eq!((reason, fault.as_str()), (ResetReason::Watchdog, ""));
    let folder = folder();
    let (_, ended) = heard(&mut start(folder.path(), Some("stuck=1500")), 11.0);
    assert_eq!(ended, None);
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn three_starts_that_panic_lead_to_safe_mode_until_the_next_reset() {
    let folder = folder();
    let (source, scene) = sensor("rest", World::default(), 5);
    let board = QemuBoard::start(machine(folder.path()), source);
    let board = RefCell::new(board.unwrap_or_else(|error| panic!("{error}")));
    let id = {
        let mut host = Host::connect(&board, scene).expect("a board");
        host.cable.push_parameters(&parameters(5)).expect("pushed").0
    };
    let mut board = board.into_inner();
    board.machine().failure = Some("panic=1500".into());
    for failures in 0..3 {
        board.restart().expect("it starts");
        let (boot, ended) = heard(&mut board, 3.0);
        let hello = boot.hello.expect("a Hello");
        assert_eq!(hello.parameter_id, ParameterId(id));
        assert_eq!((hello.safe_mode, hello.fault.is_some()), (false, failures > 0));
        assert!(ended.is_some_and(|ended| ended.contains("101")));
    }
    board.machine().failure = None;
    board.restart().expect("it starts");
    let (boot, ended) = heard(&mut board, 20.0);
    assert_eq!(ended, None);
    let hello = boot.hello.expect("a Hello");
    assert!(hello.safe_mode);
    assert!(hello.fault.expect("a fault").to_string().starts_with("panic "));
    assert_eq!(hello.parameter_id, ParameterId::UNCALIBRATED);
    assert!(boot.raw().len() > 1900, "{}", boot.raw().len());
    assert!(boot.corrected().is_empty() && boot.navigation.is_empty());
    let stack = boot.status.and_then(|status| status.stack);
    let stack = stack.expect("it is measured");
    assert!((1000..stack.size / 2).contains(&stack.used), "{stack:?}");
    board.restart().expect("it starts");
    let hello = heard(&mut board, 1.0).0.hello.expect("a Hello");
    assert_eq!((hello.safe_mode, hello.fault), (false, None));
    assert_eq!(hello.parameter_id, ParameterId(id));
}
