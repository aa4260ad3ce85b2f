//! The link between device and host, in virtual time.

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embedded_io_async::{Read, Write};
use proptest::prelude::*;
use wimu_sim::clock::{Stalled, VirtualClock};
use wimu_sim::pipe::{LinkConfig, link};

fn uart(baud: u32) -> LinkConfig {
    LinkConfig { baud: Some(baud), ..LinkConfig::default() }
}

#[test]
fn a_line_takes_ten_bits_a_byte() {
    let clock = VirtualClock::new();
    let (_reader, mut writer, mut host) = link(&clock, uart(115_200));
    let device = async {
        writer.write_all(&[0x55; 1152]).await.unwrap();
        writer.flush().await.unwrap();
        clock.now()
    };
    let sent_at = clock.run(device).unwrap();
    assert!((99_999..=100_001).contains(&sent_at), "{sent_at}");
    assert_eq!(host.pull().len(), 1152);
}

#[test]
fn bytes_come_out_one_by_one_at_the_line_rate() {
    let clock = VirtualClock::new();
    let (_reader, mut writer, mut host) = link(&clock, uart(10_000));
    clock.run(writer.write_all(&[1, 2, 3])).unwrap().unwrap();
    for (time, expected) in [(999, &[][..]), (1000, &[1]), (2999, &[2]), (3000, &[3])] {
        clock.advance_to(time);
        assert_eq!(host.available(), expected.len());
        assert_eq!(host.pull(), expected);
    }
}

#[test]
fn a_uart_whose_host_does_not_read_loses_nothing_and_never_stalls() {
    let clock = VirtualClock::new();
    let (_reader, mut writer, mut host) = link(&clock, uart(1_000_000));
    let sent: Vec<u8> = (0..100_000).map(|i| i as u8).collect();
    clock.run(writer.write_all(&sent)).unwrap().unwrap();
    clock.run(writer.flush()).unwrap().unwrap();
    assert_eq!(host.pull(), sent);
}

#[test]
fn a_stream_whose_host_does_not_read_stalls_the_writer_until_it_does() {
    let clock = VirtualClock::new();
    let (_reader, mut writer, mut host) = link(&clock, LinkConfig::default());
    assert_eq!(clock.run(writer.write_all(&[7; 1025])), Err(Stalled { at_us: 0 }));
    assert_eq!(host.pull().len(), 1024);

    let device = async {
        writer.write_all(&[8; 3000]).await.unwrap();
        clock.now()
    };
    let hosting = async {
        let mut got = 0;
        while got < 3000 {
            clock.until(clock.now() + 500).await;
            got += host.pull().len();
        }
    };
    assert_eq!(clock.run(join(device, hosting)).unwrap().0, 1000);
}

#[test]
fn a_receive_buffer_that_overflows_on_a_uart_loses_and_counts() {
    let clock = VirtualClock::new();
    let config = LinkConfig { receive_buffer: 16, ..uart(115_200) };
    let (mut reader, _writer, mut host) = link(&clock, config);
    host.push(&[9; 20]);
    clock.advance_to(10_000);
    let mut buffer = [0; 64];
    assert_eq!(clock.run(reader.read(&mut buffer)).unwrap(), Ok(16));
    assert_eq!(host.lost(), 4);
}

#[test]
fn a_stream_to_a_device_that_does_not_read_waits_and_loses_nothing() {
    let clock = VirtualClock::new();
    let config = LinkConfig { receive_buffer: 16, ..LinkConfig::default() };
    let (mut reader, _writer, mut host) = link(&clock, config);
    host.push(&[9; 20]);
    let mut buffer = [0; 20];
    clock.run(reader.read_exact(&mut buffer)).unwrap().unwrap();
    assert_eq!((buffer, host.lost()), ([9; 20], 0));
}

#[test]
fn a_dropped_host_swallows_what_the_device_sends() {
    let clock = VirtualClock::new();
    for config in [LinkConfig::default(), uart(1_000_000)] {
        let (_reader, mut writer, host) = link(&clock, config);
        drop(host);
        clock.run(writer.write_all(&[7; 5000])).unwrap().unwrap();
    }
}

proptest! {
    #[test]
    fn a_cancelled_read_loses_no_byte(
        chunks in prop::collection::vec((1_usize..20, 0_u64..3000), 1..20),
        patience in prop::collection::vec(1_u64..1500, 1..20),
        baud in prop::option::of(9_600_u32..1_000_000),
    ) {
        let clock = VirtualClock::new();
        let (mut reader, _writer, mut host) = link(&clock, LinkConfig { baud, ..Default::default() });
        let sent: Vec<u8> = (0..chunks.iter().map(|c| c.0).sum()).map(|i: usize| i as u8).collect();
        let pushing = async {
            let mut rest = &sent[..];
            for (length, pause) in chunks {
                clock.until(clock.now() + pause).await;
                let (chunk, after) = rest.split_at(length);
                host.push(chunk);
                rest = after;
            }
        };
        let reading = async {
            let mut got: Vec<u8> = Vec::new();
            let mut buffer = [0; 7];
            for wait in patience.iter().cycle() {
                match select(clock.until(clock.now() + wait), reader.read(&mut buffer)).await {
                    Either::First(()) => {}
                    Either::Second(Ok(count)) => got.extend(&buffer[..count]),
                }
                if got.len() >= sent.len() {
                    break;
                }
            }
            got
        };
        let (got, ()) = clock.run(join(reading, pushing)).unwrap();
        prop_assert_eq!(got, sent);
    }
}
