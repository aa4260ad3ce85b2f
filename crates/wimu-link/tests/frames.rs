//! What frames keep out, and what they let through.

use proptest::prelude::*;
use wimu_link::frame::{
    self, Deframer, EncodeError, FrameError, Kind, MAX_BODY, MAX_FRAME, WIRE_VERSION,
};

const KINDS: [Kind; 7] = [
    Kind::Hello,
    Kind::WhoAreYou,
    Kind::Batch,
    Kind::Telemetry,
    Kind::Request,
    Kind::Reply,
    Kind::Inertial,
];

type Received = Result<(u8, Kind, Vec<u8>), FrameError>;

fn receive(bytes: &[u8]) -> Vec<Received> {
    let mut deframer = Deframer::new();
    let mut received = Vec::new();
    for &byte in bytes {
        if let Some(frame) = deframer.push(byte) {
            received.push(frame.map(|frame| (frame.version, frame.kind, frame.body.to_vec())));
        }
    }
    received
}

fn framed(kind: Kind, body: &[u8]) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = frame::encode(kind, body, &mut line).unwrap();
    line[..length].to_vec()
}

/// A frame whose first byte is free to choose.
fn framed_as(first: u8, body: &[u8]) -> Vec<u8> {
    let mut plain = vec![first];
    plain.extend(body);
    let crc = wimu_link::crc_32c(&plain);
    plain.extend(crc.to_le_bytes());
    let mut coded = vec![0; cobs::max_encoding_length(plain.len())];
    let length = cobs::encode(&plain, &mut coded);
    coded.truncate(length);
    coded.push(0);
    coded
}

/// Bodies with and without zeros, of all lengths.
fn bodies() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        prop::collection::vec(any::<u8>(), 0..=MAX_BODY),
        prop::collection::vec(1..=255_u8, 0..=MAX_BODY),
        prop::collection::vec(0..=1_u8, 0..=MAX_BODY),
    ]
}

proptest! {
    #[test]
    fn a_frame_arrives_as_it_was_sent(kind in prop::sample::select(&KINDS[..]), body in bodies()) {
        let line = framed(kind, &body);
        prop_assert_eq!(line.iter().position(|&byte| byte == 0), Some(line.len() - 1));
        prop_assert_eq!(receive(&line), [Ok((WIRE_VERSION, kind, body.clone()))]);
        // A buffer that is one byte short is refused, never overrun.
        let mut short = vec![0; line.len() - 1];
        prop_assert_eq!(frame::encode(kind, &body, &mut short), Err(EncodeError::NoRoom));
    }

    #[test]
    fn a_damaged_frame_never_passes(
        bodies in [bodies(), bodies()],
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut line = [framed(Kind::Batch, &bodies[0]), framed(Kind::Batch, &bodies[1])].concat();
        for (at, byte) in edits {
            let at = at.index(line.len());
            line[at] = byte;
        }
        for received in receive(&line).into_iter().flatten() {
            prop_assert!(received.1 == Kind::Batch && bodies.contains(&received.2));
        }
    }

    #[test]
    fn a_splice_of_two_frames_never_passes(
        bodies in [bodies(), bodies()],
        cuts in [any::<prop::sample::Index>(), any::<prop::sample::Index>()],
    ) {
        let lines = [framed(Kind::Reply, &bodies[0]), framed(Kind::Reply, &bodies[1])];
        let head = &lines[0][..cuts[0].index(lines[0].len())];
        let tail = &lines[1][cuts[1].index(lines[1].len())..];
        for received in receive(&[head, tail].concat()).into_iter().flatten() {
            prop_assert!(bodies.contains(&received.2));
        }
    }

    #[test]
    fn the_frame_after_any_garbage_is_found(garbage in prop::collection::vec(any::<u8>(), 0..2000)) {
        let frame = framed(Kind::Telemetry, b"after");
        let line = [&garbage[..], &[0], &frame].concat();
        let last = receive(&line).pop();
        prop_assert_eq!(last, Some(Ok((WIRE_VERSION, Kind::Telemetry, b"after".to_vec()))));
    }
}

#[test]
fn a_flipped_bit_never_passes() {
    let line = framed(Kind::Batch, b"\x00body with\x00\x00zeros, and without");
    for bit in 0..line.len() * 8 {
        let mut flipped = line.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        // A flip in the closing zero leaves the frame open; a second zero closes it.
        flipped.push(0);
        assert!(receive(&flipped).iter().all(Result::is_err), "bit {bit}");
    }
}

#[test]
fn a_truncated_frame_never_passes() {
    let line = framed(Kind::Batch, &[7; 300]);
    for cut in 1..line.len() - 1 {
        for damaged in [&line[cut..], &[&line[..cut], &[0]].concat()] {
            assert!(receive(damaged).iter().all(Result::is_err), "cut {cut}");
        }
    }
}

#[test]
fn the_longest_body_fits_and_a_longer_one_is_refused() {
    for fill in [0, 1, 255] {
        let body = [fill; MAX_BODY + 1];
        assert!(framed(Kind::Reply, &body[..MAX_BODY]).len() <= MAX_FRAME);
        let mut line = [0; 2 * MAX_FRAME];
        assert_eq!(frame::encode(Kind::Reply, &body, &mut line), Err(EncodeError::BodyTooLong));
    }
}

#[test]
fn a_lost_zero_is_one_damaged_frame() {
    let mut line = framed(Kind::Batch, &[1; MAX_BODY]);
    line.pop();
    let whole = framed(Kind::Batch, b"whole");
    let line = [&line[..], &line, &[0], &whole].concat();
    let received = receive(&line);
    assert_eq!(received[0], Err(FrameError::TooLong));
    assert_eq!(received[1..], [Ok((WIRE_VERSION, Kind::Batch, b"whole".to_vec()))]);
}

#[test]
fn strangers_are_named() {
    let unknown = FrameError::UnknownKind { version: WIRE_VERSION, kind: 9 };
    assert_eq!(receive(&framed_as(WIRE_VERSION << 4 | 9, b"?")), [Err(unknown)]);
    let newer = FrameError::UnknownVersion { version: WIRE_VERSION + 1, kind: 3 };
    assert_eq!(receive(&framed_as((WIRE_VERSION + 1) << 4 | 3, b"?")), [Err(newer)]);
    assert!(!unknown.is_damage() && !newer.is_damage());
    assert_eq!(receive(&framed_as(0xf1, b"later")), [Ok((15, Kind::Hello, b"later".to_vec()))]);
}

#[test]
fn of_version_1_only_who_is_there_is_read() {
    for kind in 3..=7 {
        let received = receive(&framed_as(1 << 4 | kind, b"old"));
        assert_eq!(received, [Err(FrameError::UnknownVersion { version: 1, kind })]);
    }
}

#[test]
fn zeros_between_frames_are_nothing() {
    let frame = framed(Kind::WhoAreYou, b"");
    let line = [&[0, 0, 0], &frame[..], &[0, 0], &frame].concat();
    assert_eq!(receive(&line).len(), 2);
    assert_eq!(receive(&[5, 0]), [Err(FrameError::Cobs)]);
    assert_eq!(receive(&[2, 3, 0]), [Err(FrameError::TooShort)]);
}
