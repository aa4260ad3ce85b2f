//! Keys, sessions and what may go wrong with them, with real clients on a whole board.

use std::cell::RefCell;
use std::time::Duration;

use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::Event as Heard;
use wimu_host::{Code, Result};
use wimu_link::LinkRole;
use wimu_link::auth::DeviceKey;
use wimu_link::hello::WriteAccess;
use wimu_link::message::{Event, Settings};
use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
use wimu_node::Key;
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::scene::World;
use wimu_tests::sensor;

type Link<'a> = Client<SimLink<'a, Board>>;

const KEY: DeviceKey = DeviceKey::new([0x11; 32]);
const OTHER: DeviceKey = DeviceKey::new([0x22; 32]);
const CABLE: LinkRole = LinkRole::Cable;
const WIRELESS: LinkRole = LinkRole::Wireless;

fn start() -> RefCell<Board> {
    let source = sensor("rest", World::default(), 3);
    RefCell::new(Board::start(BoardConfig::default(), source))
}

fn connect(board: &RefCell<Board>, role: LinkRole, session: u32) -> Link<'_> {
    let options = ConnectOptions { session: Some(session), ..ConnectOptions::default() };
    Client::connect(SimLink::new(board, role), "the board", options).expect("a board")
}

/// A client that has the key.
fn owner(board: &RefCell<Board>, role: LinkRole, session: u32) -> Link<'_> {
    let mut client = connect(board, role, session);
    client.use_key(Some(KEY));
    client
}

/// A board that has been given the key.
fn start_with_key() -> RefCell<Board> {
    let board = start();
    connect(&board, CABLE, 1).set_key(KEY).expect("set");
    board
}

fn set_of(bias: f64) -> ParameterSet {
    let sensitivity = Sensitivity::from_lsb_per_g(16384.0).expect("the sensor's");
    let terms = ErrorTerms { bias_mps2: [bias, -bias, bias / 2.0], ..ErrorTerms::default() };
    ParameterSet {
        model: ErrorModel::new(terms).expect("a model"),
        ..ParameterSet::uncalibrated(2, sensitivity)
    }
}

fn set_rate(client: &mut Link<'_>, rate_hz: u16) -> Result<Settings> {
    client.set_settings(Settings { rate_hz, ..Settings::default() })
}

fn code<T>(outcome: Result<T>) -> Option<Code> {
    outcome.err().map(|error| error.code)
}

#[test]
fn a_key_opens_the_wireless_link_to_its_owner_and_closes_the_cable_to_others() {
    let board = start();
    let mut cable = connect(&board, CABLE, 1);
    let mut wireless = connect(&board, WIRELESS, 2);
    assert_eq!(cable.hello().access, WriteAccess::Open);
    assert_eq!(code(set_rate(&mut wireless, 200)), Some(Code::KeyNeeded));
    // A key does not travel over a radio: not even the host lets it.
    assert_eq!(code(wireless.set_key(KEY)), Some(Code::KeyNeeded));
    cable.set_key(KEY).expect("set");
    assert_eq!(cable.key_status(), Ok(Some(KEY.id())));
    assert_eq!(cable.hello().access, WriteAccess::Key);
    for (role, session) in [(WIRELESS, 3), (CABLE, 4)] {
        let mut owner = owner(&board, role, session);
        assert_eq!(set_rate(&mut owner, 200).map(|set| set.rate_hz), Ok(200));
        owner.push_parameters(&set_of(f64::from(session) / 10.0)).expect("pushed");
        for (key, session) in [(None, 5), (Some(OTHER), 6)] {
            let mut stranger = connect(&board, role, session);
            stranger.use_key(key);
            assert_eq!(code(set_rate(&mut stranger, 50)), Some(Code::KeyNeeded));
            assert_eq!(code(stranger.factory_reset()), Some(Code::KeyNeeded));
            let ours = stranger.use_key_among(&[OTHER]);
            assert_eq!(code(ours), Some(Code::KeyNeeded));
            assert_eq!(stranger.settings().map(|set| set.rate_hz), Ok(200), "reading is free");
        }
    }
    // Exchanged for another one, and forgotten.
    let mut cable = owner(&board, CABLE, 7);
    cable.set_key(OTHER).expect("rotated");
    let mut old = owner(&board, WIRELESS, 8);
    assert_eq!(code(set_rate(&mut old, 50)), Some(Code::KeyNeeded));
    assert_eq!(set_rate(&mut cable, 100).map(|set| set.rate_hz), Ok(100));
    cable.forget_key().expect("forgotten");
    assert_eq!(cable.key_status(), Ok(None));
    assert_eq!(set_rate(&mut cable, 200).map(|set| set.rate_hz), Ok(200));
    assert_eq!(code(set_rate(&mut old, 50)), Some(Code::KeyNeeded));
}

#[test]
fn a_key_outlives_a_restart_and_a_factory_reset_and_sessions_do_not() {
    let board = start_with_key();
    let mut wireless = owner(&board, WIRELESS, 2);
    set_rate(&mut wireless, 200).expect("set");
    board.borrow_mut().restart();
    // The client finds out, and opens another session.
    assert_eq!(set_rate(&mut wireless, 50).map(|set| set.rate_hz), Ok(50));
    wireless.factory_reset().expect("reset");
    assert_eq!(wireless.key_status(), Ok(Some(KEY.id())));
    let mut stranger = connect(&board, CABLE, 3);
    assert_eq!(code(set_rate(&mut stranger, 50)), Some(Code::KeyNeeded));
}

#[test]
fn two_hosts_at_once_both_get_through_and_agree() {
    let board = start_with_key();
    let mut hosts =
        [owner(&board, WIRELESS, 2), owner(&board, WIRELESS, 3), owner(&board, CABLE, 4)];
    let mut last = None;
    for round in 0..30_u8 {
        let host = &mut hosts[usize::from(round * 7 % 3)];
        let set = set_of(f64::from(round) / 50.0);
        last = Some(host.push_parameters(&set).expect("pushed").0);
    }
    for host in &mut hosts {
        assert_eq!(host.parameters().ok().map(|held| held.id), last);
    }
}

#[test]
fn a_board_unplugged_during_a_push_holds_the_old_set_or_the_new() {
    let board = start_with_key();
    let mut wireless = owner(&board, WIRELESS, 2);
    let mut held = wireless.push_parameters(&set_of(0.1)).expect("pushed").0;
    let mut outcomes = [0; 2];
    // Pages are erased first.
    for cut in (0..8192).step_by(900).chain((8192..9000).step_by(13)) {
        let set = set_of(0.2 + cut as f64 * 1e-4);
        board.borrow().storage().lose_power_after(Some(cut));
        let mut wireless = owner(&board, WIRELESS, cut as u32);
        let answered = wireless.push_parameters(&set).is_ok();
        board.borrow().storage().lose_power_after(None);
        board.borrow_mut().restart();
        let found = wireless.parameters().expect("answered").id;
        let new = wimu_host::calibration::parameter_id(&set).0;
        assert!(found == new || !answered && found == held, "{cut}: {found:08x}");
        outcomes[usize::from(found == new)] += 1;
        held = found;
    }
    assert!(outcomes[0] > 5 && outcomes[1] > 5, "{outcomes:?}");
}

#[test]
fn a_memory_without_a_header_locks_both_links_until_the_owner_makes_the_gesture() {
    let board = start_with_key();
    board.borrow().storage().corrupt_headers();
    board.borrow_mut().restart();
    for (role, session) in [(WIRELESS, 2), (CABLE, 3)] {
        let mut host = owner(&board, role, session);
        assert_eq!(host.hello().access, WriteAccess::Locked);
        let refused = set_rate(&mut host, 200).expect_err("locked");
        assert_eq!(refused.code, Code::DeviceRefused);
        assert!(refused.remedy.contains("wimu device key rotate"), "{refused}");
    }
    board.borrow().forget_key();
    let mut cable = connect(&board, CABLE, 4);
    cable.set_key(OTHER).expect("set");
    for restart in [false, true] {
        if restart {
            board.borrow_mut().restart();
        }
        for role in [WIRELESS, CABLE] {
            let mut host = connect(&board, role, 5);
            host.use_key(Some(OTHER));
            assert_eq!(set_rate(&mut host, 200).map(|set| set.rate_hz), Ok(200));
        }
    }
}

#[test]
fn an_unreadable_key_locks_both_links_until_the_owner_makes_the_gesture() {
    let board = start_with_key();
    let mut cable = owner(&board, CABLE, 2);
    let held = cable.push_parameters(&set_of(0.1)).expect("pushed");
    set_rate(&mut cable, 200).expect("set");
    board.borrow().storage().corrupt(Key::DeviceKey);
    board.borrow_mut().restart();
    for (role, session) in [(CABLE, 3), (WIRELESS, 4)] {
        let mut host = owner(&board, role, session);
        assert_eq!(host.hello().access, WriteAccess::Locked);
        let refused = connect(&board, role, session + 10).use_key_among(&[KEY]);
        assert_eq!(code(refused), Some(Code::DeviceRefused));
        assert_eq!(code(set_rate(&mut host, 50)), Some(Code::DeviceRefused));
        assert_eq!(host.parameters().map(|held| held.id), Ok(held.0));
    }
    board.borrow().forget_key();
    let mut cable = connect(&board, CABLE, 5);
    assert_eq!(cable.settings(), Ok(Settings::default()));
    set_rate(&mut cable, 50).expect("set");
    cable.set_key(OTHER).expect("set");
}

#[test]
fn the_gesture_erases_key_and_settings_and_never_the_calibration() {
    let board = start_with_key();
    let mut wireless = owner(&board, WIRELESS, 2);
    let held = wireless.push_parameters(&set_of(0.1)).expect("pushed");
    set_rate(&mut wireless, 200).expect("set");
    board.borrow().forget_key();
    for restart in [false, true] {
        if restart {
            board.borrow_mut().restart();
        }
        let mut cable = connect(&board, CABLE, 3);
        assert_eq!(cable.key_status(), Ok(None));
        assert_eq!(cable.settings(), Ok(Settings::default()));
        assert_eq!(cable.parameters().map(|held| held.id), Ok(held.0));
        let mut wireless = owner(&board, WIRELESS, 4);
        assert_eq!(code(set_rate(&mut wireless, 50)), Some(Code::KeyNeeded));
    }
}

#[test]
fn a_write_to_flash_is_announced_on_both_links_before_it_begins() {
    let board = start_with_key();
    let mut cable = owner(&board, CABLE, 2);
    let mut wireless = owner(&board, WIRELESS, 3);
    for client in [&mut cable, &mut wireless] {
        while client.next_event(Duration::ZERO).expect("a link").is_some() {}
    }
    // Power goes with the first byte: what was announced was announced before.
    board.borrow().storage().lose_power_after(Some(0));
    assert!(set_rate(&mut cable, 200).is_err());
    for client in [&mut cable, &mut wireless] {
        let mut announced = false;
        while let Some(arrival) = client.next_event(Duration::from_millis(5)).expect("a link") {
            announced |= matches!(
                arrival.event,
                Heard::Device { event: Event::Pause { longest_ms: 90 }, .. }
            );
            if announced {
                break;
            }
        }
        assert!(announced);
    }
}

#[test]
fn no_recording_holds_a_key() {
    let board = start();
    let options = ConnectOptions { keep_data: true, ..ConnectOptions::default() };
    let link = SimLink::new(&board, CABLE);
    let mut cable = Client::connect(link, "the board", options).expect("a board");
    cable.set_key(KEY).expect("set");
    cable.set_key(OTHER).expect("rotated");
    let all = format!("{:?}", cable.take_data());
    for byte in [0x11, 0x22] {
        let run = format!("{byte}, {byte}, {byte}, {byte}");
        assert!(!all.contains(&run));
    }
    assert!(all.contains("Sent"));
}
