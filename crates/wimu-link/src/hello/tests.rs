extern crate std;

use std::string::ToString;

use super::*;
use crate::frame::{Deframer, MAX_FRAME};

fn example() -> Hello {
    Hello {
        access: WriteAccess::Open,
        device_id: 0x0123_4567_89ab_cdef,
        boot_count: 7,
        capabilities: Capabilities::ACCELEROMETER.with(Capabilities::STORE),
        parameter_id: ParameterId(0xdead_beef),
        uptime_us: 1 << 40,
        firmware: [1, 256, 3],
        reset_reason: ResetReason::BrownOut,
        sensitivity_known: true,
        board: Part::new(board::SIMULATED, "simulated"),
        sensor: Part::new(sensor::LSM303AGR, "LSM303AGR"),
        ..Hello::new(LinkRole::Wireless)
    }
}

fn body(hello: &Hello) -> ([u8; 256], usize) {
    let mut line = [0; MAX_FRAME];
    let length = hello.encode(&mut line).unwrap();
    let mut deframer = Deframer::new();
    for &byte in &line[..length] {
        if let Some(frame) = deframer.push(byte) {
            let frame = frame.unwrap();
            let mut body = [0; 256];
            body[..frame.body.len()].copy_from_slice(frame.body);
            return (body, frame.body.len());
        }
    }
    panic!("no frame");
}

#[test]
fn fields_stand_where_the_table_says() {
    let (body, length) = body(&example());
    assert_eq!(length, 80);
    assert_eq!(&body[..8], b"WIMU\x50\x03\x02\x00");
    assert_eq!(body[8..16], 0x0123_4567_89ab_cdef_u64.to_le_bytes());
    assert_eq!(body[16..20], 7_u32.to_le_bytes());
    assert_eq!(body[20..24], 0b10001_u32.to_le_bytes());
    assert_eq!(body[24..28], 0xdead_beef_u32.to_le_bytes());
    assert_eq!(body[28..36], (1_u64 << 40).to_le_bytes());
    assert_eq!(body[36..42], [1, 0, 0, 1, 3, 0]);
    assert_eq!(body[42..44], [5, 1]);
    assert_eq!(body[44..48], [1, 0, 1, 0]);
    assert_eq!(&body[48..64], b"\x09simulated\0\0\0\0\0\0");
    assert_eq!(&body[64..80], b"\x09LSM303AGR\0\0\0\0\0\0");
    assert_eq!(Hello::decode(&body[..length]), Ok(example()));
}

#[test]
fn a_later_version_with_more_fields_and_extensions_is_read() {
    let (mut body, length) = body(&example());
    body[4] = 83;
    body[length..length + 3].copy_from_slice(&[1, 2, 3]);
    body[83..89].copy_from_slice(&[9, 2, 0xaa, 0xbb, 10, 200]);
    assert_eq!(Hello::decode(&body[..89]), Ok(example()));
    assert!(extensions(&body[..89]).eq([(9, &[0xaa, 0xbb][..])]));
}

#[test]
fn unknown_numbers_are_kept() {
    let (mut body, length) = body(&example());
    (body[6], body[7], body[42], body[45]) = (77, 78, 79, 80);
    body[23] = 0x80;
    let hello = Hello::decode(&body[..length]).unwrap();
    assert_eq!(hello.role, LinkRole::Other(77));
    assert_eq!(hello.access, WriteAccess::Other(78));
    assert_eq!(hello.reset_reason, ResetReason::Other(79));
    assert_eq!(hello.board.number, 80 << 8 | 1);
    assert_eq!(hello.capabilities.0, 0x8000_0011);
}

#[test]
fn a_strange_name_is_made_readable() {
    assert_eq!(Name::new("µ-board with a long name").as_str(), "??-board with a");
    let (mut body, length) = body(&example());
    body[48] = 255;
    let hello = Hello::decode(&body[..length]).unwrap();
    assert_eq!(hello.board.name.as_str(), "simulated??????");
}

#[test]
fn a_cut_or_foreign_greeting_is_refused() {
    let (mut body, length) = body(&example());
    for cut in 0..length {
        let expected = if cut < 4 { HelloError::NotWimu } else { HelloError::TooShort };
        assert_eq!(Hello::decode(&body[..cut]), Err(expected));
    }
    body[4] = 79;
    assert_eq!(Hello::decode(&body[..length]), Err(HelloError::TooShort));
    body[0] = b'w';
    assert_eq!(Hello::decode(&body[..length]), Err(HelloError::NotWimu));
}

#[test]
fn who_are_you_is_read_in_every_version() {
    assert_eq!(WhoAreYou::decode(b"WIMU\x08\x03ab and more"), Ok(WhoAreYou { wire_version: 3 }));
    assert_eq!(WhoAreYou::decode(b"WIMU\x05\x03"), Err(HelloError::TooShort));
}

#[test]
fn where_the_firmware_stopped_is_an_extension() {
    let fault = Fault::panic([0x0001_1128, 0x1009_afff]);
    let stopped = Hello { reset_reason: ResetReason::Fault, fault: Some(fault), ..example() };
    let (body, length) = body(&stopped);
    assert_eq!(&body[80..length], b"\x01\x12\x28\x11\x01\x00panic 1009afff");
    assert_eq!(Hello::decode(&body[..length]), Ok(stopped));
    assert_eq!(fault.to_string(), "panic 1009afff at 0x00011128");
    let processor = Fault::processor("hard fault", 0x1000_0231);
    assert_eq!(processor.to_string(), "hard fault at 0x10000231");
    // A truncated one is ignored.
    for cut in 80..length {
        let hello = Hello::decode(&body[..cut]).unwrap();
        assert_eq!(hello.fault, None, "{cut}");
    }
}
