//! Requests and replies between both ends.

use std::time::Duration;

use proptest::prelude::*;
use wimu_link::auth::{DeviceKey, KeyId, KeyState, Lock, Session};
use wimu_link::hello::LinkRole;
use wimu_link::message::{
    Answer, Command, Payload, Refusal, Reply, Request, Resolution, SetBytes, Settings, Signature,
    Streams,
};
use wimu_link::requester::{Next, Requester};
use wimu_link::responder::{Decision, Responder};
use wimu_link::{Deframer, Kind, MAX_FRAME};
use wimu_testkit::trials;

const NOW: Duration = Duration::from_secs(5);

fn body(line: &[u8], kind: Kind) -> Vec<u8> {
    let mut deframer = Deframer::new();
    line.iter()
        .find_map(|&byte| {
            let frame = deframer.push(byte)?.unwrap();
            assert_eq!(frame.kind, kind);
            Some(frame.body.to_vec())
        })
        .unwrap()
}

fn request(session: u32, id: u32, command: Command) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let request = Request { session, id, signature: Signature::NONE, command };
    let length = request.encode(&mut line).unwrap();
    body(&line[..length], Kind::Request)
}

fn answer(line: &[u8]) -> Answer {
    Reply::decode(&body(line, Kind::Reply)).unwrap().answer
}

/// A long set.
fn set() -> SetBytes {
    SetBytes::new(&[7; 240]).unwrap()
}

fn writes() -> [Command; 3] {
    [
        Command::SetParameters(set()),
        Command::FactoryReset,
        Command::SetSettings(Settings::default()),
    ]
}

/// A device without a key.
fn open() -> Lock {
    Lock { key: KeyState::None, boot_count: Some(1), ..Lock::default() }
}

/// A device that remembers what it carried out.
struct Device {
    responder: Responder,
    settings: Settings,
    effects: Vec<Command>,
}

impl Device {
    fn new(role: LinkRole) -> Self {
        Self { responder: Responder::new(role), settings: Settings::default(), effects: Vec::new() }
    }

    fn hear(&mut self, body: &[u8]) -> Vec<u8> {
        let command = match self.responder.accept(body, &open()) {
            Decision::Execute(command) => command,
            Decision::Send(frame) => return frame.to_vec(),
            Decision::Ignore => return Vec::new(),
        };
        self.effects.push(command);
        let answer: Answer = match command {
            Command::GetParameters => Answer::Accepted(Payload::Parameters(set())),
            Command::SetSettings(settings) => {
                self.settings = settings;
                Answer::Accepted(Payload::None)
            }
            Command::GetSettings => Answer::Accepted(Payload::Settings(self.settings)),
            _ => Answer::Accepted(Payload::None),
        };
        self.responder.reply(&answer, &mut [0; MAX_FRAME]).to_vec()
    }
}

#[test]
fn a_repeated_request_has_one_effect_and_gets_the_same_bytes() {
    for command in writes().into_iter().chain([Command::GetSettings]) {
        let mut device = Device::new(LinkRole::Cable);
        let request = request(1, 1, command);
        let first = device.hear(&request);
        assert!(!first.is_empty());
        for _ in 0..5 {
            assert_eq!(device.hear(&request), first);
        }
        assert_eq!(device.effects.len(), 1);
    }
}

#[test]
fn a_long_answer_to_a_read_is_made_anew_when_it_was_lost() {
    let mut device = Device::new(LinkRole::Cable);
    let read = request(1, 1, Command::GetParameters);
    let first = device.hear(&read);
    assert!(first.len() > 200, "{}", first.len());
    assert_eq!(device.hear(&read), first);
    assert_eq!(device.effects, [Command::GetParameters; 2]);
}

#[test]
fn every_answer_to_a_write_is_kept_at_its_longest() {
    let longest: [Answer; 4] = [
        Answer::Accepted(Payload::Session { number: u32::MAX, nonce: [0xff; 16] }),
        Answer::Accepted(Payload::Settings(FARTHEST)),
        Answer::Accepted(Payload::KeyStatus { key: Some(KeyId([0xff; 4])) }),
        Answer::Refused(Refusal::UnsupportedSettings { nearest: FARTHEST }),
    ];
    let key = DeviceKey::new([1; 32]);
    let lock = Lock { key: KeyState::Set(key), ..open() };
    for answer in longest {
        let mut responder = Responder::new(LinkRole::Cable);
        let mut requester = Requester::new(u32::MAX);
        let open = requester.start(Command::OpenSession, NOW).to_vec();
        let Decision::Send(frame) = responder.accept(&body(&open, Kind::Request), &lock) else {
            panic!("no session");
        };
        let Answer::Accepted(Payload::Session { number, nonce }) = self::answer(frame) else {
            panic!("no session");
        };
        let session = Session { key, role: LinkRole::Cable, device_id: 0, number, nonce };
        requester.sign(session, u32::MAX);
        let write = requester.start(Command::FactoryReset, NOW).to_vec();
        let write = body(&write, Kind::Request);
        assert!(matches!(
            responder.accept(&write, &lock),
            Decision::Execute(Command::FactoryReset)
        ));
        let reply = responder.reply(&answer, &mut [0; MAX_FRAME]).to_vec();
        // The session's number, 1, is as short as they get: four bytes less than the longest.
        assert!(reply.len() + 4 <= 80, "{answer:?}");
        assert_eq!(responder.accept(&write, &lock), Decision::Send(&reply));
    }
}

const FARTHEST: Settings = {
    let streams = Streams {
        raw: true,
        corrected: true,
        navigation: true,
        environment: true,
        batch: u8::MAX,
        every: u8::MAX,
    };
    Settings {
        range_g: u8::MAX,
        rate_hz: u16::MAX,
        resolution: Resolution::High,
        zupt: true,
        gravity_um_s2: u32::MAX,
        cable: streams,
        wireless: streams,
    }
};

#[test]
fn a_repeat_while_it_is_carried_out_is_ignored() {
    let mut responder = Responder::new(LinkRole::Cable);
    let reset = request(1, 1, Command::FactoryReset);
    let other = request(2, 1, Command::GetStatus);
    assert!(matches!(responder.accept(&reset, &open()), Decision::Execute(Command::FactoryReset)));
    for body in [&reset, &other] {
        assert_eq!(responder.accept(body, &open()), Decision::Ignore);
    }
    let failed = Answer::Refused(Refusal::StoreFailed);
    let reply = responder.reply(&failed, &mut [0; MAX_FRAME]).to_vec();
    assert_eq!(answer(&reply), failed);
    assert_eq!(responder.accept(&reset, &open()), Decision::Send(&reply));
    // What was ignored was not taken as heard.
    assert!(matches!(responder.accept(&other, &open()), Decision::Execute(Command::GetStatus)));
}

#[test]
fn a_read_that_comes_late_is_answered_and_a_write_is_stale() {
    let mut device = Device::new(LinkRole::Cable);
    let write = request(1, 5, Command::SetSettings(Settings::default()));
    let written = device.hear(&write);
    // Somebody has used ids of this session farther on, or another session since.
    for (session, id) in [(1, 9), (2, 1)] {
        device.hear(&request(session, id, Command::GetKeyStatus));
        let read = device.hear(&request(1, 4, Command::GetSettings));
        let settings = Answer::Accepted(Payload::Settings(Settings::default()));
        assert_eq!(answer(&read), settings);
        for id in [3, 5] {
            let late = device.hear(&request(1, id, Command::FactoryReset));
            assert_eq!(answer(&late), Answer::Refused(Refusal::Stale));
        }
        assert_eq!(answer(&device.hear(&write)), Answer::Refused(Refusal::Stale));
    }
    let writes = device.effects.iter().filter(|command| command.is_write());
    assert_eq!(writes.count(), 1);
    // What was late has not taken the place of the latest answer.
    let latest = request(1, 10, Command::SetSettings(Settings::default()));
    let reply = device.hear(&latest);
    assert_eq!(answer(&reply), answer(&written));
    device.hear(&request(1, 4, Command::GetSettings));
    assert_eq!(device.hear(&latest), reply);
}

/// A device with a key, and a host that signs.
fn with_session(responder: &mut Responder) -> (Lock, Requester) {
    let key = DeviceKey::new([1; 32]);
    let lock = Lock { key: KeyState::Set(key), ..open() };
    let mut requester = Requester::new(77);
    let open = requester.start(Command::OpenSession, NOW).to_vec();
    let Decision::Send(frame) = responder.accept(&body(&open, Kind::Request), &lock) else {
        panic!("no session");
    };
    let Answer::Accepted(Payload::Session { number, nonce }) = answer(frame) else {
        panic!("no session");
    };
    let session = Session { key, role: LinkRole::Wireless, device_id: 0, number, nonce };
    requester.sign(session, 1);
    (lock, requester)
}

/// Bytes of answers to requests that come every millisecond for 20 s.
fn answered(responder: &mut Responder, lock: &Lock, mut ask: impl FnMut(u32) -> Vec<u8>) -> usize {
    let long: Answer = Answer::Accepted(Payload::Parameters(set()));
    let asked = (0..20_000_u32).map(|ms| {
        let body = ask(ms);
        match responder.accept_at(&body, lock, u64::from(ms) * 1000) {
            Decision::Send(frame) => frame.len(),
            Decision::Execute(_) => responder.reply(&long, &mut [0; MAX_FRAME]).len(),
            Decision::Ignore => 0,
        }
    });
    asked.sum()
}

#[test]
fn answers_that_take_no_key_are_limited_where_there_is_one() {
    let mut responder = Responder::new(LinkRole::Wireless);
    let (lock, mut requester) = with_session(&mut responder);
    let flood = |command| move |ms: u32| request(ms, 1, command);
    for (command, rate) in [
        (Command::OpenSession, 500),
        (Command::GetKeyStatus, 500),
        (Command::GetParameters, 2000),
        (Command::FactoryReset, 2000),
    ] {
        let mut responder = Responder::new(LinkRole::Wireless);
        let bytes = answered(&mut responder, &lock, flood(command));
        // 20 s, a burst of 1 s, and the answer that empties the bucket.
        let expected = 21 * rate..=21 * rate + MAX_FRAME;
        assert!(expected.contains(&bytes), "{command:?}: {bytes}");
        // The others are answered; so is the same, later.
        for (other, ms) in
            [(Command::OpenSession, 20_000), (Command::GetKeyStatus, 20_000), (command, 23_000)]
        {
            let fresh = request(1, 1, other);
            let decision = responder.accept_at(&fresh, &lock, ms * 1000);
            let ignored = decision == Decision::Ignore;
            assert_eq!(ignored, other == command && ms == 20_000, "{other:?}");
            responder.reply(&Answer::Unknown, &mut [0; MAX_FRAME]);
        }
        // Without a key all are.
        let mut responder = Responder::new(LinkRole::Wireless);
        let bytes = answered(&mut responder, &open(), flood(command));
        assert!(bytes >= 20_000 * 12, "{command:?}: {bytes}");
    }
    // Each new one that the owner signs is taken, whatever is between.
    for ms in 0..2000_u64 {
        let garbage = request(ms as u32, 1, Command::GetParameters);
        if let Decision::Execute(_) = responder.accept_at(&garbage, &lock, ms * 1000) {
            responder.reply(&Answer::Unknown, &mut [0; MAX_FRAME]);
        }
        let signed = body(requester.start(Command::FactoryReset, NOW), Kind::Request);
        let decision = responder.accept_at(&signed, &lock, ms * 1000);
        assert_eq!(decision, Decision::Execute(Command::FactoryReset));
        assert!(responder.is_signed());
        let done: Answer = Answer::Accepted(Payload::None);
        responder.reply(&done, &mut [0; MAX_FRAME]);
    }
    // A stranger who repeats it has it answered seldom.
    let signed = body(requester.start(Command::GetStatus, NOW), Kind::Request);
    let bytes = answered(&mut responder, &lock, |_| signed.clone());
    // Once a second at least, as if each answer were as long as it can be.
    let least = 20 * 200;
    assert!((least..=21_000 + MAX_FRAME).contains(&bytes), "{bytes}");
}

#[test]
fn an_answer_to_anybody_serves_who_asks_the_same_in_vain() {
    let session = Answer::Accepted(Payload::Session { number: 5, nonce: [3; 16] });
    let key = Answer::Accepted(Payload::KeyStatus { key: None });
    let late = NOW + Duration::from_millis(500);
    for (command, fits, other) in
        [(Command::OpenSession, session, key), (Command::GetKeyStatus, key, session)]
    {
        let to = |session, id, signature, answer: Answer| {
            let mut line = [0; MAX_FRAME];
            let reply = Reply { session, id, signature, answer };
            let length = reply.encode(&mut line).unwrap();
            body(&line[..length], Kind::Reply)
        };
        let mut requester = Requester::new(9);
        requester.start(command, NOW);
        let overheard = to(1, 1, Signature::NONE, fits);
        // It is answered itself, usually.
        assert_eq!(requester.on_reply(&overheard), None);
        assert!(matches!(requester.poll(late), Next::Send(_)));
        let signed = to(1, 1, Signature::new(&[1; 8]).unwrap(), fits);
        let refused = to(1, 1, Signature::NONE, Answer::Refused(Refusal::Locked));
        for useless in [signed, refused, to(1, 1, Signature::NONE, other)] {
            assert_eq!(requester.on_reply(&useless), None);
        }
        assert_eq!(requester.on_reply(&overheard), Some(fits));
        assert!(!requester.is_authenticated());
    }
    // What was asked signed is answered signed.
    let mut responder = Responder::new(LinkRole::Wireless);
    let (_, mut requester) = with_session(&mut responder);
    requester.start(Command::GetKeyStatus, NOW);
    assert!(matches!(requester.poll(late), Next::Send(_)));
    let mut line = [0; MAX_FRAME];
    let reply = Reply { session: 1, id: 1, signature: Signature::NONE, answer: key };
    let length = reply.encode(&mut line).unwrap();
    assert_eq!(requester.on_reply(&body(&line[..length], Kind::Reply)), None);
}

#[test]
fn an_unsigned_write_passes_only_on_the_cable_of_a_device_without_a_key() {
    let has = |key, boot_count| Lock { key, boot_count, ..Lock::default() };
    let key = KeyState::Set(DeviceKey::new([1; 32]));
    let (cable, radio, other) = (LinkRole::Cable, LinkRole::Wireless, LinkRole::Other(9));
    for (role, lock, expected) in [
        (cable, has(KeyState::None, Some(1)), None),
        (cable, has(KeyState::None, None), None),
        (cable, has(key, Some(1)), Some(Refusal::SignatureNeeded)),
        (cable, has(KeyState::Unreadable, Some(1)), Some(Refusal::Locked)),
        (radio, has(KeyState::None, Some(1)), Some(Refusal::KeyNeeded)),
        (radio, has(KeyState::None, None), Some(Refusal::Locked)),
        (radio, has(key, Some(1)), Some(Refusal::SignatureNeeded)),
        (radio, has(key, None), Some(Refusal::Locked)),
        (radio, has(KeyState::Unreadable, Some(1)), Some(Refusal::Locked)),
        (other, has(KeyState::None, Some(1)), Some(Refusal::KeyNeeded)),
    ] {
        for command in writes() {
            let mut responder = Responder::new(role);
            match (responder.accept(&request(1, 1, command), &lock), expected) {
                (Decision::Execute(executed), None) => {
                    assert_eq!(executed, command);
                }
                (Decision::Send(frame), Some(refusal)) => {
                    assert_eq!(answer(frame), Answer::Refused(refusal));
                }
                (decision, _) => panic!("{role} {lock:?}: {decision:?}"),
            }
        }
        let mut responder = Responder::new(role);
        assert!(matches!(
            responder.accept(&request(1, 1, Command::GetStatus), &lock),
            Decision::Execute(Command::GetStatus)
        ));
        if role != cable {
            for command in [Command::SetKey(DeviceKey::new([2; 32])), Command::ForgetKey] {
                let mut responder = Responder::new(role);
                let Decision::Send(frame) = responder.accept(&request(2, 1, command), &lock) else {
                    panic!("{role} {lock:?}");
                };
                assert_eq!(answer(frame), Answer::Refused(Refusal::CableOnly));
            }
        }
    }
}

#[test]
fn an_unknown_command_is_answered_as_unknown() {
    let mut responder = Responder::new(LinkRole::Cable);
    let mut body = request(300, 5, Command::GetStatus);
    *body.last_mut().unwrap() = 99;
    let Decision::Send(frame) = responder.accept(&body, &open()) else {
        panic!("not answered");
    };
    assert_eq!(answer(frame), Answer::Unknown);
    // A known command that goes on is not the command we know.
    let mut body = request(300, 6, Command::GetStatus);
    body.push(0);
    let Decision::Send(frame) = responder.accept(&body, &open()) else {
        panic!("not answered");
    };
    assert_eq!(answer(frame), Answer::Unknown);
    // Bytes without a session and an id cannot be answered.
    for cut in 0..3 {
        let body = &request(1, 1, Command::GetStatus)[..cut];
        assert_eq!(responder.accept(body, &open()), Decision::Ignore);
    }
}

#[test]
fn an_old_request_and_a_reused_id_are_stale() {
    let mut device = Device::new(LinkRole::Cable);
    let stale = Answer::Refused(Refusal::Stale);
    let old = request(u32::MAX, u32::MAX, Command::FactoryReset);
    let late = request(u32::MAX, 0, Command::GetSettings);
    device.hear(&old);
    let answered = device.hear(&late);
    assert_eq!(answer(&device.hear(&old)), stale);
    let reused = request(u32::MAX, 0, Command::FactoryReset);
    assert_eq!(answer(&device.hear(&reused)), stale);
    // Neither spoils the answer to the latest.
    assert_eq!(device.hear(&late), answered);
    assert_eq!(device.effects.len(), 2);
}

#[test]
fn sessions_do_not_repeat_each_others_requests() {
    let mut device = Device::new(LinkRole::Cable);
    let requests: Vec<_> =
        (0..4).map(|session| request(session, 7, Command::FactoryReset)).collect();
    for request in &requests {
        device.hear(request);
    }
    assert_eq!(device.effects.len(), 4);
    for request in &requests {
        assert!(!device.hear(request).is_empty());
    }
    assert_eq!(device.effects.len(), 4);
}

#[test]
fn a_reply_to_nothing_is_empty() {
    let mut responder = Responder::new(LinkRole::Cable);
    let answer: Answer = Answer::Unknown;
    assert!(responder.reply(&answer, &mut [0; MAX_FRAME]).is_empty());
}

#[test]
fn a_host_asks_again_and_gives_up_in_time() {
    let interval = Duration::from_millis(100);
    let mut requester = Requester::with_timing(9, interval, 3);
    assert_eq!(requester.poll(NOW), Next::Idle);
    let first = requester.start(Command::GetStatus, NOW).to_vec();
    assert_eq!(requester.poll(NOW), Next::Wait { until: NOW + interval });
    assert_eq!(requester.poll(NOW + interval), Next::Send(&first));
    // A host that slept asks once, not for every time it missed.
    let awake = NOW + 20 * interval;
    assert_eq!(requester.poll(awake), Next::Send(&first));
    assert_eq!(requester.poll(awake), Next::Wait { until: awake + interval });
    assert_eq!(requester.poll(awake + interval), Next::TimedOut);
    assert_eq!(requester.poll(awake + interval), Next::Idle);
}

#[test]
fn only_the_reply_to_the_waiting_request_is_taken() {
    let mut requester = Requester::new(9);
    let answer = Answer::Accepted(Payload::None);
    let reply = |session, id| {
        let reply = Reply { session, id, signature: Signature::NONE, answer };
        let mut line = [0; MAX_FRAME];
        let length = reply.encode(&mut line).unwrap();
        body(&line[..length], Kind::Reply)
    };
    assert_eq!(requester.on_reply(&reply(9, 0)), None);
    requester.start(Command::FactoryReset, NOW);
    requester.start(Command::GetStatus, NOW);
    for other in [reply(8, 2), reply(9, 1), reply(9, 3)] {
        assert_eq!(requester.on_reply(&other), None);
    }
    assert_eq!(requester.on_reply(&reply(9, 2)), Some(answer));
    assert_eq!(requester.on_reply(&reply(9, 2)), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(trials(10_000) as u32))]

    /// Both ends over a line that loses, doubles and delays frames.
    #[test]
    fn over_a_bad_line_a_request_has_one_effect_at_most_and_exactly_one_if_answered(
        count in 1..12_u16,
        luck in prop::collection::vec((0..4_u8, 0..4_u8), 200),
    ) {
        let mut device = Device::new(LinkRole::Cable);
        let mut requester = Requester::new(77);
        let mut luck = luck.into_iter().cycle();
        let mut now = NOW;
        let mut late: Vec<Vec<u8>> = Vec::new();
        for rate_hz in 1..=count {
            let wanted = Settings { rate_hz, ..Settings::default() };
            let mut line = Some(requester.start(Command::SetSettings(wanted), now).to_vec());
            let mut answered = None;
            while let Some(frame) = line.take() {
                let (there, back) = luck.next().unwrap();
                let request = body(&frame, Kind::Request);
                let mut replies = Vec::new();
                if let (1, Some(old)) = (there, late.pop()) {
                    replies.push(device.hear(&old));
                }
                for _ in 0..there {
                    replies.push(device.hear(&request));
                }
                late.push(request);
                for reply in replies.iter().filter(|reply| !reply.is_empty() && back > 0) {
                    let reply = body(reply, Kind::Reply);
                    answered = answered.or(requester.on_reply(&reply));
                }
                now += Duration::from_millis(500);
                if let Next::Send(frame) = requester.poll(now) {
                    line = Some(frame.to_vec());
                }
            }
            if let Some(answer) = answered {
                prop_assert_eq!(answer, Answer::Accepted(Payload::None));
                prop_assert_eq!(device.settings, wanted);
            }
        }
        // Each at most once, and in the order in which they were asked for.
        let rates: Vec<_> = device
            .effects
            .iter()
            .map(|command| match command {
                Command::SetSettings(settings) => settings.rate_hz,
                other => panic!("{other:?}"),
            })
            .collect();
        prop_assert!(rates.is_sorted_by(|a, b| a < b), "{:?}", rates);
    }
}
