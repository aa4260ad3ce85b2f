//! Rates of lines: changed at both ends, found, and gone back to.

use std::cell::RefCell;
use std::time::Duration;

use wimu_host::ErrorCode;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::transport::Transport;
use wimu_link::message::{Payload, Refusal};
use wimu_link::{Answer, Command, LinkRole};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::World;
use wimu_tests::{Rig, sensor, who_are_you};

fn board() -> RefCell<Board> {
    let source = sensor("rest", World::default(), 4);
    RefCell::new(Board::start(BoardConfig::default(), source))
}

fn connect(board: &RefCell<Board>, role: LinkRole) -> wimu_host::Result<Client<SimLink<'_>>> {
    let options = ConnectOptions { session: Some(3), ..ConnectOptions::default() };
    Client::connect(SimLink::new(board, role), "the link", options)
}

/// The rate of the host's end.
fn set(board: &RefCell<Board>, role: LinkRole, baud: u32) {
    board.borrow_mut().link(role).set_baud(baud);
}

fn run(board: &RefCell<Board>, seconds: u64) {
    let end_us = board.borrow().now_us() + seconds * 1_000_000;
    board.borrow_mut().run_until(end_us);
}

#[test]
fn both_ends_change_their_rate_and_the_board_keeps_it_over_a_restart() {
    let board = board();
    let mut client = connect(&board, LinkRole::Cable).expect("a board");
    for baud in [9600, 460_800, 230_400] {
        client.set_line_rate(baud).expect("a new rate");
        assert_eq!(client.transport().baud(), Some(baud));
        assert!(client.status().is_ok());
    }
    // It is stored once it has worked.
    run(&board, 1);
    board.borrow_mut().restart();
    assert!(connect(&board, LinkRole::Cable).is_ok());
    set(&board, LinkRole::Cable, 115_200);
    let error = connect(&board, LinkRole::Cable).err().expect("rubbish");
    assert_eq!(error.code(), ErrorCode::NotAWimuBoard);
}

#[test]
fn a_host_that_does_not_know_the_rate_finds_it() {
    let board = board();
    let mut client = connect(&board, LinkRole::Cable).expect("a board");
    client.set_line_rate(57_600).expect("a new rate");
    set(&board, LinkRole::Cable, 115_200);
    let mut client =
        Client::find_rate(SimLink::new(&board, LinkRole::Cable), "the link").expect("a board");
    assert_eq!(client.transport().baud(), Some(57_600));
    assert!(client.status().is_ok());
}

#[test]
fn a_board_whose_host_is_lost_in_the_middle_goes_back() {
    let mut rig = Rig::usual();
    rig.run(2.0);
    let link = LinkRole::Cable.number();
    let answer = rig.ask(LinkRole::Cable, Command::SetLineRate { link, baud: 9600 });
    assert_eq!(answer, Answer::Accepted(Payload::None));
    // The host stays at the old rate, hears rubbish, and says nothing.
    rig.run(0.2);
    let before = rig.link(LinkRole::Cable).record().statistics.frames;
    rig.run(4.0);
    assert_eq!(
        rig.link(LinkRole::Cable).record().statistics.frames,
        before,
        "frames at another rate"
    );
    rig.run(2.0);
    let status = rig.status();
    assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
    rig.link(LinkRole::Wireless).assert_perfect();
    // Nothing was stored.
    rig.restart();
    rig.run(2.0);
    rig.status();
}

/// A host whose port takes any rate and stays at its own.
struct Stubborn<'a>(SimLink<'a>);

impl Transport for Stubborn<'_> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> wimu_host::Result<usize> {
        self.0.read(buffer, timeout)
    }

    fn write_all(&mut self, bytes: &[u8]) -> wimu_host::Result<()> {
        self.0.write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.0.now()
    }

    fn baud(&self) -> Option<u32> {
        self.0.baud()
    }

    fn set_baud(&mut self, _baud: u32) -> wimu_host::Result<()> {
        Ok(())
    }
}

#[test]
fn a_line_that_does_not_carry_the_new_rate_is_back_at_the_old_one_at_both_ends() {
    let board = board();
    let link = Stubborn(SimLink::new(&board, LinkRole::Cable));
    let mut client = Client::connect(link, "the link", ConnectOptions::default()).expect("a board");
    let error = client.set_line_rate(921_600).expect_err("not carried");
    assert_eq!(error.code(), ErrorCode::NoAnswer);
    assert!(error.to_string().contains("back at 115200"), "{error}");
    assert!(client.status().is_ok());
}

#[test]
fn a_board_finds_the_rate_of_its_radio_adapter_and_keeps_it() {
    for baud in [9600, 38_400, 115_200] {
        let board = board();
        set(&board, LinkRole::Wireless, baud);
        // A round of the rates takes 6 s, a host that connects has 3.
        let found = (0..3).find_map(|_| connect(&board, LinkRole::Wireless).ok());
        assert!(found.expect("a board").status().is_ok(), "{baud}");
        run(&board, 1);
        board.borrow_mut().restart();
        let mut again = connect(&board, LinkRole::Wireless).expect("a board");
        assert!(again.status().is_ok());
        assert!(board.borrow().now_us() - board.borrow().started_us() < 1_500_000);
        assert!(connect(&board, LinkRole::Cable).is_ok());
    }
}

#[test]
fn a_radio_adapters_rate_is_set_over_the_cable_alone() {
    let board = board();
    let mut wireless = connect(&board, LinkRole::Wireless).expect("a board");
    let error = wireless.set_line_rate(57_600).expect_err("a radio");
    assert_eq!(error.code(), ErrorCode::Usage);
    assert!(error.to_string().contains("radio adapter"), "{error}");

    let mut cable = connect(&board, LinkRole::Cable).expect("a board");
    let link = LinkRole::Wireless.number();
    let command = Command::SetLineRate { link, baud: 57_600 };
    assert!(matches!(cable.request(command), Ok(Payload::None)));
    set(&board, LinkRole::Wireless, 57_600);
    assert!(connect(&board, LinkRole::Wireless).is_ok());
}

#[test]
fn rates_that_cannot_be_are_refused() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let ask =
        |rig: &mut Rig, link, baud| rig.ask(LinkRole::Cable, Command::SetLineRate { link, baud });
    let cable = LinkRole::Cable.number();
    for (baud, nearest) in [(0, 300), (299, 300), (u32::MAX, 4_000_000)] {
        assert_eq!(
            ask(&mut rig, cable, baud),
            Answer::Refused(Refusal::UnsupportedLineRate { nearest })
        );
    }
    for link in [0, 3, 255] {
        let answer = ask(&mut rig, link, 9600);
        assert_eq!(answer, Answer::Refused(Refusal::FixedLineRate));
    }
    // A link without a rate says so, and so does the host's end of it.
    let roomy = LinkConfig::default();
    let config = BoardConfig { cable: roomy, wireless: roomy, ..BoardConfig::default() };
    let mut rig = Rig::new(config, sensor("rest", World::default(), 4));
    rig.run(1.0);
    let answer = ask(&mut rig, cable, 9600);
    assert_eq!(answer, Answer::Refused(Refusal::FixedLineRate));
    let board = RefCell::new(rig.board);
    let mut client = connect(&board, LinkRole::Cable).expect("a board");
    let error = client.set_line_rate(9600).expect_err("no rate");
    assert_eq!(error.code(), ErrorCode::Usage);
}

#[test]
fn silence_and_questions_do_not_move_a_rate_that_works() {
    let mut rig = Rig::usual();
    rig.run(30.0);
    rig.send(LinkRole::Wireless, &who_are_you());
    rig.run(5.0);
    rig.link(LinkRole::Wireless).assert_perfect();
}
