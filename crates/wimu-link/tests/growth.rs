//! What ends of a wire version make of what later ones of that version may say, and of other versions.

use std::time::Duration;

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use wimu_integrator::State;
use wimu_link::auth::{DeviceKey, KeyState, Lock, Session};
use wimu_link::frame::{self, Frame, FrameError};
use wimu_link::message::{
    Epoch, EpochGyroscope, EpochReason, Event, MessageError, Payload, Refusal, Signature,
    StackStatus, Status,
};
use wimu_link::responder::{Decision, Responder};
use wimu_link::{
    Answer, Command, Kind, LinkRole, MAX_FRAME, Reply, Request, Requester, Telemetry, WhoAreYou,
};

const KEY: DeviceKey = DeviceKey::new([7; 32]);

/// What comes of a frame.
fn heard<T>(line: &[u8], each: impl Fn(Result<Frame<'_>, FrameError>) -> T) -> T {
    let mut deframer = frame::Deframer::new();
    let mut bytes = line;
    each(deframer.next(&mut bytes).expect("a frame"))
}

fn body_of(encode: impl FnOnce(&mut [u8]) -> Result<usize, frame::EncodeError>) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = encode(&mut line).expect("room");
    heard(&line[..length], |frame| frame.expect("own frame").body.to_vec())
}

#[test]
fn fields_that_a_later_device_adds_at_the_end_are_left() {
    // With all fields of today.
    let status = Status { uptime_us: 5, stack: Some(StackStatus::default()), ..Status::default() };
    let answer = Answer::Accepted(Payload::Status(status));
    let status = Telemetry::Status(status);
    let mut body = body_of(|line| status.encode(line));
    body.extend([1, 2, 3]);
    assert_eq!(Telemetry::decode(&body), Ok(status));

    let reply: Reply = Reply { session: 1, id: 2, signature: Signature::NONE, answer };
    let mut body = body_of(|line| reply.encode(line));
    body.extend([1, 2, 3]);
    assert_eq!(Reply::decode(&body), Ok(reply));
}

#[test]
fn a_request_with_more_than_the_device_knows_is_not_obeyed() {
    let request =
        Request { session: 1, id: 2, signature: Signature::NONE, command: Command::FactoryReset };
    let mut body = body_of(|line| request.encode(line));
    body.push(1);
    assert!(Request::decode(&body).is_err());
    let mut responder = Responder::new(LinkRole::Cable);
    let lock = Lock { key: KeyState::None, boot_count: Some(1), ..Lock::default() };
    let Decision::Send(frame) = responder.accept(&body, &lock) else {
        panic!("it was obeyed");
    };
    let reply = heard(frame, |frame| Reply::decode(frame.expect("own").body));
    assert_eq!(reply.map(|reply| reply.answer), Ok(Answer::Unknown));
}

#[test]
fn an_event_and_a_refusal_that_are_new_are_told_as_such() {
    let event: Telemetry = Telemetry::Event { time_us: 300, event: Event::SensorFound };
    let mut body = body_of(|line| event.encode(line));
    let number = body.len() - 1;
    body[number] = 99;
    body.extend([1, 2]);
    let event = Telemetry::Event { time_us: 300, event: Event::Other { number: 99 } };
    assert_eq!(Telemetry::decode(&body), Ok(event));
    assert!(Event::Other { number: 99 }.to_string().contains("update"));

    // As part of a longer message nothing can be made of it.
    body[0] = 50;
    assert!(Telemetry::decode(&body).is_err());

    let reply: Reply = Reply {
        session: 1,
        id: 2,
        signature: Signature::NONE,
        answer: Answer::Refused(Refusal::Stale),
    };
    let mut body = body_of(|line| reply.encode(line));
    let number = body.len() - 1;
    body[number] = 77;
    body.extend([5; 8]);
    let refusal = Refusal::Other { number: 77 };
    let answer = Reply::decode(&body).map(|reply| reply.answer);
    assert_eq!(answer, Ok(Answer::Refused(refusal)));
    assert!(refusal.to_string().contains("update"));
}

#[test]
fn the_signature_of_an_answer_holds_for_what_is_not_known_of_it_too() {
    let session =
        Session { key: KEY, role: LinkRole::Wireless, device_id: 9, number: 3, nonce: [4; 16] };
    let mut requester = Requester::new(1);
    requester.sign(session, 100);
    let ask = |requester: &mut Requester| {
        let frame = requester.start(Command::GetStatus, Duration::ZERO).to_vec();
        heard(&frame, |frame| Request::decode(frame.expect("own").body)).expect("own")
    };
    // Both as a later device would say them: a refusal of a new kind, and a longer status.
    let status: Reply = Reply {
        session: 1,
        id: 2,
        signature: Signature::NONE,
        answer: Answer::Accepted(Payload::Status(Status::default())),
    };
    let mut longer = body_of(|line| status.encode(line)).split_off(3);
    longer.extend([7, 7]);
    for (answer, known) in [
        (vec![1, 77, 1, 2], Answer::Refused(Refusal::Other { number: 77 })),
        (longer, Answer::Accepted(Payload::Status(Status::default()))),
    ] {
        let request = ask(&mut requester);
        let mut mac = Hmac::<Sha256>::new_from_slice(KEY.expose()).expect("any length");
        mac.update(b"a\x02");
        mac.update(&session.device_id.to_le_bytes());
        mac.update(&session.number.to_le_bytes());
        mac.update(&session.nonce);
        mac.update(&request.id.to_le_bytes());
        mac.update(request.signature.as_bytes());
        mac.update(&answer);
        let mut reply = vec![request.session as u8, request.id as u8, 8];
        reply.extend(&mac.finalize().into_bytes()[..8]);
        reply.extend(&answer);
        let mut forged = reply.clone();
        *forged.last_mut().expect("bytes") ^= 1;
        assert_eq!(requester.on_reply(&forged), None);
        assert_eq!(requester.on_reply(&reply), Some(known));
    }
}

#[test]
fn an_epoch_of_other_arithmetic_still_places_samples() {
    let epoch = Epoch {
        reason: EpochReason::Gap,
        number: 1,
        sequence: 2,
        time_us: 3,
        period_ns: 4,
        range_g: 2,
        sensitivity_lsb_per_g: 16384.0,
        full_scale: 32767,
        parameters: 5,
        temperature_centi_c: Some(6),
        revision: 200,
        state: State::default(),
        sensor: 7,
        gyroscope: Some(EpochGyroscope { rad_s_per_lsb: 0.5, full_scale: 8 }),
        tag: Signature::new(&[9; 8]).expect("short enough"),
    };
    let telemetry = Telemetry::Epoch(epoch);
    let body = body_of(|line| telemetry.encode(line));
    assert_eq!(Telemetry::decode(&body), Ok(telemetry));
    assert!(!epoch.is_ours());
    // Whatever its state looks like: it follows the tag.
    let tag = body.iter().rposition(|&byte| byte == 9).expect("a tag");
    let mut other = body[..=tag].to_vec();
    other.extend([0xFF; 30]);
    assert_eq!(Telemetry::decode(&other), Ok(telemetry));
    for cut in 0..=tag {
        assert_eq!(Telemetry::decode(&body[..cut]), Err(MessageError::TooShort));
    }
}

/// Who is there is read for ever, nothing else.
#[test]
fn another_version_is_refused_by_name_and_its_greeting_is_read() {
    // Empty telemetry of version 4, an event and a greeting of version 1, and their CRC-32C.
    let later = [6, 0x44, 0xF2, 0xD9, 0x9C, 0xD4, 0];
    let earlier = [9, 0x14, 6, 5, 1, 0xB6, 0x47, 0xD3, 0xA4, 0];
    let versions = [(4, &later[..], "update this end"), (1, &earlier[..], "update the other end")];
    for (version, line, advice) in versions {
        heard(line, |frame| {
            let error = frame.expect_err("another version");
            assert_eq!(error, FrameError::UnknownVersion { version, kind: 4 });
            assert!(error.to_string().ends_with(advice), "{error}");
        });
    }
    let greeting = [0x0C, 0x12, 0x57, 0x49, 0x4D, 0x55, 6, 1, 0xFC, 0xEE, 0x7C, 0x99, 0];
    heard(&greeting, |frame| {
        let frame = frame.expect("for ever");
        let host = WhoAreYou::decode(frame.body).expect("for ever");
        assert_eq!((frame.kind, host.wire_version), (Kind::WhoAreYou, 1));
    });
}
