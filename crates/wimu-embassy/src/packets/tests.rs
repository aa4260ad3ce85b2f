use std::vec::Vec;

use embassy_futures::block_on;
use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use wimu_link::Kind;
use wimu_link::frame::RequestDeframer;

use super::*;

/// The bytes of the next packet of at most `most` bytes.
async fn packet(link: &PacketLink, most: usize) -> Vec<u8> {
    let mut packet = std::vec![0; most];
    let length = link.next_packet(&mut packet).await;
    packet[..length].to_vec()
}

/// What `future` returns if it ends without waiting for anyone.
fn at_once<T>(future: impl Future<Output = T>) -> Option<T> {
    let some_turns = async {
        for _ in 0..10 {
            yield_now().await;
        }
    };
    match block_on(select(future, some_turns)) {
        Either::First(value) => Some(value),
        Either::Second(()) => None,
    }
}

#[test]
fn bytes_are_split_into_packets_in_order_and_none_is_longer_than_the_connection_allows() {
    let link = PacketLink::new();
    let (_, mut writer) = link.split();
    link.connect();
    let bytes: Vec<u8> = (1..=255).cycle().take(5000).collect();
    for most in [1, 20, 244] {
        let mut received = Vec::new();
        let radio = async {
            while received.len() < bytes.len() {
                let packet = packet(&link, most).await;
                assert!((1..=most).contains(&packet.len()));
                received.extend(packet);
            }
        };
        let (sent, ()) = block_on(join(writer.write_all(&bytes), radio));
        sent.unwrap();
        assert_eq!(received, bytes);
    }
    assert_eq!(link.dropped(), 0);
}

#[test]
fn a_radio_that_takes_nothing_makes_the_writer_wait_and_a_lost_connection_releases_it() {
    let link = PacketLink::new();
    let (_, mut writer) = link.split();
    link.connect();
    let bytes = [1; OUTGOING + 1];
    assert_eq!(at_once(writer.write_all(&bytes)), None);
    assert_eq!(at_once(writer.flush()), None);
    assert_eq!(link.dropped(), 0);
    let (written, ()) = block_on(join(writer.write_all(&bytes[..100]), async {
        link.disconnect();
    }));
    written.unwrap();
    assert_eq!(at_once(writer.flush()), Some(Ok(())));
    assert_eq!(link.dropped(), OUTGOING as u32 + 100);
}

#[test]
fn without_a_connection_bytes_are_dropped_and_counted() {
    let link = PacketLink::new();
    let (_, mut writer) = link.split();
    block_on(writer.write_all(&[1; 2000])).unwrap();
    assert_eq!(link.dropped(), 2000);
    link.connect();
    assert_eq!(at_once(packet(&link, 20)), None);
}

#[test]
fn a_new_host_gets_whole_frames_only() {
    let link = PacketLink::new();
    let (_, mut writer) = link.split();
    // The connection begins within a frame, then at the end of one, then within one that is partly sent.
    for (before, after, expected) in [
        (&b"fra"[..], &b"me\0next\0"[..], &b"next\0"[..]),
        (b"frame\0", b"next\0", b"next\0"),
        (b"", b"next\0", b"next\0"),
    ] {
        block_on(writer.write_all(before)).unwrap();
        link.connect();
        block_on(writer.write_all(after)).unwrap();
        assert_eq!(at_once(packet(&link, 20)).unwrap(), expected, "{before:?}");
        link.disconnect();
    }
    link.connect();
    block_on(writer.write_all(b"abc")).unwrap();
    link.disconnect();
    link.connect();
    let before = link.dropped();
    block_on(writer.write_all(b"de\0f\0")).unwrap();
    assert_eq!(at_once(packet(&link, 20)).unwrap(), b"f\0");
    assert_eq!(link.dropped() - before, 3);
}

#[test]
fn each_connection_asks_the_node_once_who_it_is_even_after_half_a_request() {
    let link = PacketLink::new();
    let (mut reader, _) = link.split();
    let mut deframer = RequestDeframer::default();
    for _ in 0..3 {
        link.connect();
        let mut bytes = [0; 64];
        let mut questions = 0;
        while let Some(Ok(read)) = at_once(reader.read(&mut bytes)) {
            for byte in &bytes[..read] {
                if let Some(Ok(frame)) = deframer.push(*byte) {
                    questions += u32::from(frame.kind == Kind::WhoAreYou);
                }
            }
        }
        assert_eq!(questions, 1);
        block_on(link.receive(b"half a requ"));
        block_on(reader.read(&mut bytes)).unwrap();
        bytes[..11].iter().for_each(|byte| {
            deframer.push(*byte);
        });
        link.disconnect();
    }
}

#[test]
fn received_bytes_wait_for_the_node_and_come_in_order() {
    let link = PacketLink::new();
    let (mut reader, _) = link.split();
    link.connect();
    let mut bytes = [0; 64];
    let question = block_on(reader.read(&mut bytes)).unwrap();
    assert!(question < QUESTION);
    let sent: Vec<u8> = (0..=255).cycle().take(3000).collect();
    let mut received = Vec::new();
    let node = async {
        while received.len() < sent.len() {
            let read = reader.read(&mut bytes).await.unwrap();
            received.extend_from_slice(&bytes[..read]);
        }
    };
    block_on(join(link.receive(&sent), node));
    assert_eq!(received, sent);
    // A node that does not read holds the radio until the connection ends.
    assert_eq!(at_once(link.receive(&sent)), None);
    block_on(join(link.receive(&sent), async { link.disconnect() }));
}
