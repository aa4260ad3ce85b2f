//! A client of a board whose line loses, delays and forges.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use wimu_host::calibration::parameter_id;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::Event;
use wimu_host::transport::Transport;
use wimu_host::{Code, Result};
use wimu_link::auth::{KeyState, Lock};
use wimu_link::hello::Capabilities;
use wimu_link::message::{
    Answer, Command, Environment, Epoch, EpochGyroscope, Event as DeviceEvent, Payload, Refusal,
    Reply, Request, SetBytes, Signature,
};
use wimu_link::responder::Decision;
use wimu_link::{
    Deframer, Hello, Kind, LinkRole, MAX_FRAME, Responder, Settings, Telemetry, WriteAccess,
};
use wimu_model::{
    Alignment, CompiledSet, Counts, ErrorModel, ErrorTerms, ParameterSet, Sensitivity,
    SpecificForceQ16,
};

use crate::common::frames::{epoch, telemetry};

/// Most of all pauses between two answers that a client believes.
const MAX_PAUSES: Duration = Duration::from_secs(6);

/// A board in virtual time: the device side of the protocol, and a line that can be made bad.
struct Board {
    now: Duration,
    deframer: Deframer,
    responder: Responder,
    hello: Hello,
    settings: Settings,
    active: SetBytes,
    commits: u32,
    /// On their way to the host.
    outgoing: VecDeque<u8>,
    /// Frames from the host to lose.
    lose_received: u32,
    /// Frames to the host to lose.
    lose_sent: u32,
    /// Requests to refuse as stale, unsigned.
    stale: u32,
    /// Unsigned requests that were taken.
    asked: Vec<(u32, u32)>,
    /// Device time at which it sends what it measures.
    next_environment: Duration,
    lock: Lock,
    silent: bool,
    deaf_until: Duration,
    /// Says this much longer pause before it stores.
    pause: Option<Duration>,
    /// Somebody says this pause, ms, with all that the board measures.
    forged_pause_ms: Option<u16>,
    /// Holds this, whatever it was sent.
    holds: Option<SetBytes>,
    /// Nominal scale of the gyroscope in its epochs, rad/s per LSB.
    gyroscope: Option<f64>,
    heard_while_deaf: u32,
    /// Brings these bytes without end instead, if there are any.
    flood: Vec<u8>,
}

#[derive(Clone)]
struct Line(Rc<RefCell<Board>>);

impl Line {
    fn new(role: LinkRole) -> Self {
        Self(Rc::new(RefCell::new(Board {
            now: Duration::from_secs(100),
            deframer: Deframer::new(),
            responder: Responder::new(role),
            hello: Hello { access: WriteAccess::Open, ..Hello::new(role) },
            settings: Settings::default(),
            active: SetBytes::NONE,
            commits: 0,
            outgoing: VecDeque::new(),
            lose_received: 0,
            lose_sent: 0,
            stale: 0,
            asked: Vec::new(),
            next_environment: Duration::ZERO,
            silent: false,
            lock: Lock { key: KeyState::None, device_id: 0, boot_count: Some(1), entropy: [0; 16] },
            deaf_until: Duration::ZERO,
            pause: None,
            forged_pause_ms: None,
            holds: None,
            gyroscope: None,
            heard_while_deaf: 0,
            flood: Vec::new(),
        })))
    }

    fn board(&self) -> std::cell::RefMut<'_, Board> {
        self.0.borrow_mut()
    }

    fn connect(&self) -> Result<Client<Self>> {
        let options = ConnectOptions { session: Some(7), ..ConnectOptions::default() };
        Client::connect(self.clone(), "test", options)
    }
}

impl Board {
    fn send(&mut self, frame: &[u8]) {
        if self.lose_sent > 0 {
            self.lose_sent -= 1;
        } else if !self.silent {
            self.outgoing.extend(frame);
        }
    }

    fn say(&mut self, message: &Telemetry) {
        self.outgoing.extend(telemetry(message));
    }

    fn hear(&mut self, kind: Kind, body: &[u8]) {
        if self.now < self.deaf_until {
            self.heard_while_deaf += 1;
            return;
        }
        if self.lose_received > 0 {
            self.lose_received -= 1;
            return;
        }
        let mut frame = [0; MAX_FRAME];
        if kind == Kind::WhoAreYou {
            let length = self.hello.encode(&mut frame).unwrap();
            return self.send(&frame[..length]);
        }
        let request = Request::decode(body).unwrap();
        self.asked.push((request.session, request.id));
        if self.stale > 0 {
            self.stale -= 1;
            let reply: Reply = Reply {
                session: request.session,
                id: request.id,
                signature: Signature::NONE,
                answer: Answer::Refused(Refusal::Stale),
            };
            let length = reply.encode(&mut frame).unwrap();
            return self.send(&frame[..length]);
        }
        let command = match self.responder.accept(body, &self.lock) {
            Decision::Execute(command) => command,
            Decision::Send(frame) => {
                let frame = frame.to_vec();
                return self.send(&frame);
            }
            Decision::Ignore => return,
        };
        let answer = self.execute(command);
        let frame = self.responder.reply(&answer, &mut frame).to_vec();
        self.send(&frame);
    }

    fn execute(&mut self, command: Command) -> Answer {
        Answer::Accepted(match command {
            Command::SetParameters(bytes) => {
                let range_g = bytes.set().unwrap().unwrap().range_g();
                if range_g != self.settings.range_g {
                    return Answer::Refused(Refusal::WrongRange {
                        parameters_g: range_g,
                        device_g: self.settings.range_g,
                    });
                }
                if let Some(pause) = self.pause {
                    self.deaf_until = self.now + pause;
                    self.say(&Telemetry::Event {
                        time_us: 0,
                        event: DeviceEvent::Pause { longest_ms: pause.as_millis() as u16 },
                    });
                }
                self.active = self.holds.unwrap_or(bytes);
                self.commits += 1;
                Payload::None
            }
            Command::GetParameters => Payload::Parameters(self.active),
            Command::GetSettings => Payload::Settings(self.settings),
            Command::SetSettings(settings) => {
                self.settings = settings;
                Payload::Settings(settings)
            }
            Command::FactoryReset => {
                self.active = SetBytes::NONE;
                Payload::None
            }
            _ => return Answer::Unknown,
        })
    }
}

impl Transport for Line {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let mut board = self.board();
        if !board.flood.is_empty() {
            board.now += Duration::from_millis(10);
            let count = buffer.len().min(board.flood.len());
            buffer[..count].copy_from_slice(&board.flood[..count]);
            return Ok(count);
        }
        if board.outgoing.is_empty() {
            let due = board.next_environment.saturating_sub(board.now);
            let quiet = if board.silent { timeout } else { timeout.min(due) };
            board.now += quiet.max(Duration::from_millis(1));
        }
        if board.now >= board.next_environment && !board.silent {
            board.next_environment = board.now + Duration::from_millis(100);
            let time_us = board.now.as_micros() as u64;
            board.say(&Telemetry::Environment(Environment { time_us, ..Environment::default() }));
            if let Some(rad_s_per_lsb) = board.gyroscope {
                let gyroscope = Some(EpochGyroscope { rad_s_per_lsb, full_scale: 32_767 });
                board.say(&Telemetry::Epoch(Epoch { gyroscope, ..epoch(0, time_us) }));
            }
            if let Some(longest_ms) = board.forged_pause_ms {
                board.say(&Telemetry::Event { time_us, event: DeviceEvent::Pause { longest_ms } });
            }
        }
        assert!(board.now < Duration::from_secs(400), "blocked");
        let count = board.outgoing.len().min(buffer.len()).min(7);
        for (place, byte) in buffer.iter_mut().zip(board.outgoing.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let mut board = self.board();
        for &byte in bytes {
            let heard = match board.deframer.push(byte) {
                Some(Ok(frame)) => (frame.kind, frame.body.to_vec()),
                _ => continue,
            };
            board.hear(heard.0, &heard.1);
        }
        Ok(())
    }

    fn now(&self) -> Duration {
        self.0.borrow().now
    }
}

fn calibration() -> ParameterSet {
    ParameterSet {
        model: ErrorModel::new(ErrorTerms { bias_mps2: [0.1, -0.2, 0.3], ..ErrorTerms::default() })
            .unwrap(),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap())
    }
}

#[test]
fn parameters_are_compiled_stored_and_read_back() {
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    assert_eq!(client.hello().role, LinkRole::Cable);
    let set = calibration();
    assert_eq!(client.push_parameters(&set).unwrap(), parameter_id(&set));
    let held = line.board().active.set().unwrap().unwrap();
    assert_eq!((held.source(), held.device()), (parameter_id(&set), 0));
    client.factory_reset().unwrap();
    assert_eq!(client.parameters().unwrap().active, None);
}

#[test]
fn a_line_that_loses_frames_both_ways_changes_nothing() {
    for lose_received in 0..4 {
        for lose_sent in 0..4 {
            let line = Line::new(LinkRole::Cable);
            let mut client = line.connect().unwrap();
            line.board().lose_received = lose_received;
            line.board().lose_sent = lose_sent;
            // After the last attempt, what the board holds decides.
            client.push_parameters(&calibration()).unwrap();
            assert_eq!(line.board().commits, 1);
        }
    }
}

#[test]
fn a_push_that_never_arrives_is_not_answered() {
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().lose_received = 100;
    let error = client.push_parameters(&calibration()).unwrap_err();
    assert_eq!((error.code, line.board().commits), (Code::NoAnswer, 0));
}

#[test]
fn a_board_that_holds_something_else_is_found_out() {
    let set = calibration();
    // Nothing, and other integers of the same calibration.
    let other = CompiledSet::compile(&set, parameter_id(&set), 5).unwrap();
    for held in [SetBytes::NONE, SetBytes::from(&other)] {
        let line = Line::new(LinkRole::Cable);
        line.board().holds = Some(held);
        let error = line.connect().unwrap().push_verified(&set).unwrap_err();
        assert_eq!(error.code, Code::VerifyFailed);
    }
}

#[test]
fn an_uncalibrated_gyroscope_is_rotated_with_the_accelerometer() {
    // A quarter turn about z: body y is sensor x.
    let alignment = Alignment::from_quaternion([0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()]);
    let set = ParameterSet { alignment: alignment.unwrap(), ..calibration() };
    for scale in [Some(1e-3), None] {
        let line = Line::new(LinkRole::Cable);
        line.board().hello.capabilities = Capabilities::GYROSCOPE;
        line.board().gyroscope = scale;
        let mut client = line.connect().unwrap();
        let pushed = client.push_parameters(&set);
        if scale.is_none() {
            // Its scale is not known.
            let code = pushed.unwrap_err().code;
            assert_eq!((code, line.board().commits), (Code::NoAnswer, 0));
            continue;
        }
        pushed.unwrap();
        let held = line.board().active.set().unwrap().unwrap();
        let gyroscope = held.gyroscope(None).unwrap();
        let rate = gyroscope.correct(Counts([1000, 0, 0]), SpecificForceQ16::default()).to_rad_s();
        assert!((rate[1] - 1.0).abs() < 1e-5 && rate[0].abs() < 1e-5, "{rate:?}");
    }
}

#[test]
fn the_host_keeps_silent_while_the_board_writes_its_flash() {
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().pause = Some(Duration::from_millis(400));
    client.push_parameters(&calibration()).unwrap();
    assert_eq!(line.board().heard_while_deaf, 0);
    assert_eq!(line.board().commits, 1);
}

#[test]
fn a_question_that_is_stale_is_asked_again_in_a_new_session_and_a_write_is_not() {
    for stale in 0..=3 {
        let line = Line::new(LinkRole::Cable);
        let mut client = line.connect().unwrap();
        client.settings().unwrap();
        line.board().asked.clear();
        line.board().stale = stale;
        client.settings().unwrap();
        // Session 7, request 2; then the first of others.
        let mut expected = vec![(7, 2)];
        expected.extend((1..=stale).map(|renewed| (7 + renewed, 1)));
        assert_eq!(line.board().asked, expected);
    }
    // Somebody refuses without end.
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().stale = u32::MAX;
    let error = client.settings().unwrap_err();
    assert_eq!(error.code, Code::DeviceRefused);
    assert_eq!(line.board().asked.len(), 4);
    // Another host's write may have come between.
    line.board().stale = 1;
    line.board().asked.clear();
    let error = client.set_settings(Settings::default()).unwrap_err();
    assert_eq!(error.code, Code::DeviceRefused);
    assert_eq!(line.board().asked.len(), 1);
}

#[test]
fn nothing_received_while_waiting_is_lost() {
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().lose_received = 3;
    client.settings().unwrap();
    let mut times = Vec::new();
    while times.len() < 30 {
        let arrival = client.next_event(Duration::from_secs(1)).unwrap().unwrap();
        if let Event::Environment(environment) = arrival.event {
            times.push(environment.time_us);
        }
    }
    assert!(times.is_sorted());
    assert!(times[0] <= 100_100_000, "the first is from before the greeting");
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] <= 160_000), "{times:?}");
}

#[test]
fn garbage_before_the_greeting_does_not_hide_it() {
    let line = Line::new(LinkRole::Cable);
    line.board().outgoing.extend([0x55; 900]);
    line.board().lose_received = 1;
    assert!(line.connect().is_ok());
}

#[test]
fn a_board_of_another_version_is_named_even_if_it_does_not_hear() {
    // Telemetry of version 4, empty, and its CRC-32C; an event of version 1.
    let later = vec![6, 0x44, 0xF2, 0xD9, 0x9C, 0xD4, 0];
    let earlier = vec![9, 0x14, 6, 5, 1, 0xB6, 0x47, 0xD3, 0xA4, 0];
    for (version, sent) in [(4, later), (1, earlier)] {
        let line = Line::new(LinkRole::Cable);
        line.board().silent = true;
        line.board().outgoing.extend(sent);
        let error = line.connect().err().unwrap();
        assert_eq!(error.code, Code::ProtocolVersion, "{error}");
        let says = format!("version {version} ");
        assert!(error.text.contains(&says), "{error}");
    }
}

#[test]
fn waiting_for_an_event_ends_in_time() {
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    while client.next_event(Duration::ZERO).unwrap().is_some() {}
    line.board().silent = true;
    line.board().outgoing.clear();
    let start = line.now();
    assert!(client.next_event(Duration::from_millis(500)).unwrap().is_none());
    assert!(line.now() - start <= Duration::from_millis(510));
}

#[test]
fn pauses_without_end_hold_up_a_request_for_seconds_only() {
    // One after the other, and all the longest that there is.
    for forged_pause_ms in [90, 500, u16::MAX] {
        let line = Line::new(LinkRole::Cable);
        let mut client = line.connect().unwrap();
        line.board().forged_pause_ms = Some(forged_pause_ms);
        for _ in 0..5 {
            let start = line.now();
            client.settings().unwrap();
            let took = line.now() - start;
            assert!(took <= MAX_PAUSES + Duration::from_secs(1), "{took:?}");
        }
        // A board that does not answer at all is given up, too.
        line.board().lose_received = u32::MAX;
        let start = line.now();
        let error = client.settings().unwrap_err();
        assert_eq!(error.code, Code::NoAnswer);
        let took = line.now() - start;
        assert!(took <= MAX_PAUSES + Duration::from_secs(10), "{took:?}");
    }
}

#[test]
fn one_pause_is_believed_up_to_its_limit() {
    for (longest_ms, expected_ms) in [(400, 400), (2000, 2000), (2001, 2000), (u16::MAX, 2000)] {
        let line = Line::new(LinkRole::Cable);
        let mut client = line.connect().unwrap();
        line.board()
            .say(&Telemetry::Event { time_us: 0, event: DeviceEvent::Pause { longest_ms } });
        let is_pause =
            |event: &Event| matches!(event, Event::Device { event: DeviceEvent::Pause { .. }, .. });
        let mut next = || client.next_event(Duration::from_millis(100)).unwrap();
        while next().is_none_or(|arrival| !is_pause(&arrival.event)) {}
        let start = line.now();
        client.settings().unwrap();
        let waited = (line.now() - start).as_millis();
        let expected = expected_ms - 120..expected_ms + 60;
        assert!(expected.contains(&waited), "{longest_ms}: {waited}");
    }
}

#[test]
fn what_waits_to_be_handed_out_is_bounded_and_what_is_dropped_counted() {
    let found = DeviceEvent::SensorFound;
    let event = telemetry(&Telemetry::Event { time_us: 0, event: found });
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().flood = event.repeat(100);
    while client.statistics().events_dropped == 0 {
        assert_eq!(client.settings().unwrap_err().code, Code::NoAnswer);
    }
    let statistics = client.statistics();
    let left = client.take_events().len() as u64;
    assert!(left <= 16_384, "{left}");
    assert!(statistics.frames.abs_diff(statistics.events_dropped + left) <= 1, "{statistics:?}");
}

#[test]
fn noise_without_end_is_no_board_and_no_event() {
    let noise = vec![0x55; 4096];
    let patience = Duration::from_secs(1000);
    let options = ConnectOptions { patience, ..ConnectOptions::default() };
    let line = Line::new(LinkRole::Cable);
    line.board().flood = noise.clone();
    let error = Client::connect(line, "test", options).err().unwrap();
    assert_eq!(error.code, Code::NotAWimuBoard);
    let line = Line::new(LinkRole::Cable);
    let mut client = line.connect().unwrap();
    line.board().flood = noise;
    client.take_events();
    let before = client.statistics().bytes;
    assert!(client.next_event(patience).unwrap().is_none());
    assert!(client.statistics().bytes - before <= 1 << 17);
}
