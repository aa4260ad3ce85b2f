//! The rate of the wireless line: a setting that holds from the next start on.

use std::cell::RefCell;

use wimu_host::Code;
use wimu_host::client::{Client, ConnectOptions};
use wimu_link::message::{Payload, Refusal};
use wimu_link::{Answer, Command, LinkRole};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::World;
use wimu_tests::{Rig, sensor};

fn connect(board: &RefCell<Board>, role: LinkRole) -> wimu_host::Result<Client<SimLink<'_>>> {
    let options = ConnectOptions { session: Some(3), ..ConnectOptions::default() };
    Client::connect(SimLink::new(board, role), "the link", options)
}

#[test]
fn a_rate_holds_from_the_next_start_on_and_the_cable_keeps_its_own() {
    let source = sensor("rest", World::default(), 4);
    let board = RefCell::new(Board::start(BoardConfig::default(), source));
    for baud in [9600, 460_800] {
        let mut cable = connect(&board, LinkRole::Cable).expect("the cable");
        cable.set_line_rate(baud).expect("a new rate");
        assert!(connect(&board, LinkRole::Wireless).is_ok(), "the rate is the old one until then");
        board.borrow_mut().restart();
        let error = connect(&board, LinkRole::Wireless).err().expect("rubbish");
        assert_eq!(error.code, Code::NotAWimuBoard);
        board.borrow_mut().link(LinkRole::Wireless).set_baud(baud);
        let mut wireless = connect(&board, LinkRole::Wireless).expect("the new rate");
        assert!(wireless.status().is_ok());
    }
}

#[test]
fn rates_that_cannot_be_are_refused() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    let ask = |rig: &mut Rig, baud| rig.ask(LinkRole::Cable, Command::SetLineRate { baud });
    for (baud, nearest) in [(0, 300), (299, 300), (u32::MAX, 4_000_000)] {
        let refused = Answer::Refused(Refusal::UnsupportedLineRate { nearest });
        assert_eq!(ask(&mut rig, baud), refused);
    }
    assert_eq!(ask(&mut rig, 9600), Answer::Accepted(Payload::None));
    let roomy = LinkConfig::default();
    let config = BoardConfig { cable: roomy, wireless: roomy, ..BoardConfig::default() };
    let mut rig = Rig::new(config, sensor("rest", World::default(), 4));
    rig.run(1.0);
    assert_eq!(ask(&mut rig, 9600), Answer::Refused(Refusal::FixedLineRate));
}
