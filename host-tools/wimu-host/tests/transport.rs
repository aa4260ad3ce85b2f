//! Open links, and the ports of this computer.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::time::Duration;

use wimu_host::transport::{UsbId, open, ports};
use wimu_host::{Code, LinkUrl};

const SHORT: Duration = Duration::from_millis(20);

const LONG: Duration = Duration::from_secs(5);

fn listen() -> (TcpListener, LinkUrl) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let link = format!("tcp://{}", listener.local_addr().unwrap());
    (listener, link.parse().unwrap())
}

#[test]
fn tcp_reads_writes_times_out_and_tells_a_closed_link() {
    let (listener, url) = listen();
    let mut link = open(&url).unwrap();
    let (mut board, _) = listener.accept().unwrap();
    let mut buffer = [0; 8];
    assert_eq!(link.read(&mut buffer, SHORT).unwrap(), 0);
    assert_eq!(link.read(&mut buffer, Duration::ZERO).unwrap(), 0);
    board.write_all(&[1, 2, 3]).unwrap();
    assert_eq!(link.read(&mut buffer, LONG).unwrap(), 3);
    assert_eq!(buffer[..3], [1, 2, 3]);
    link.write_all(&[4, 5]).unwrap();
    board.read_exact(&mut buffer[..2]).unwrap();
    assert_eq!(buffer[..2], [4, 5]);
    drop(board);
    let error = link.read(&mut buffer, LONG).unwrap_err();
    assert_eq!(error.code, Code::LinkLost);
    assert_eq!(error.place.at.as_deref(), Some(url.to_string().as_str()));
}

#[cfg(unix)]
#[test]
fn a_serial_port_carries_bytes_and_has_one_owner() {
    use serialport::{SerialPort as _, TTYPort};

    let (mut board, slave) = TTYPort::pair().unwrap();
    let url = LinkUrl::Serial { path: slave.name().unwrap(), baud: 115_200 };
    drop(slave);
    let mut link = open(&url).unwrap();
    let error = open(&url).err().unwrap();
    assert_eq!(error.code, Code::LinkBusy, "{error}");
    assert_eq!(link.baud(), Some(115_200));
    let mut buffer = [0; 8];
    assert_eq!(link.read(&mut buffer, SHORT).unwrap(), 0);
    board.write_all(&[0, 255, 13, 10]).unwrap();
    let mut received = Vec::new();
    while received.len() < 4 {
        let count = link.read(&mut buffer, LONG).unwrap();
        received.extend_from_slice(&buffer[..count]);
    }
    assert_eq!(received, [0, 255, 13, 10]);
    link.write_all(&[7]).unwrap();
    board.read_exact(&mut buffer[..1]).unwrap();
    assert_eq!(buffer[0], 7);
    drop(board);
    assert_eq!(link.read(&mut buffer, LONG).unwrap_err().code, Code::LinkLost);
}

#[test]
fn known_boards_are_told_by_their_usb_identity() {
    let board = |vendor, product| UsbId { vendor, product }.board();
    assert_eq!(board(0x0d28, 0x0204), Some("micro:bit"));
    assert!(board(0x2e8a, 0x000a).is_some());
    assert_eq!(board(0x10c4, 0x0001), None);
    assert_eq!(board(0x1d6b, 0x0002), None);
    for port in ports().unwrap() {
        assert_eq!(port.board, port.usb.and_then(UsbId::board));
    }
}
