//! A stream over the Nordic UART Service.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use wimu_host::Code;
use wimu_host::transport::Transport;
use wimu_host::transport::nus::{NusLink, Peripheral};

/// A peripheral in memory: notifications from a channel, writes kept.
struct Fake {
    longest: usize,
    confirms: bool,
    notifications: Receiver<Vec<u8>>,
    written: Sender<(Vec<u8>, bool)>,
}

impl Peripheral for Fake {
    fn longest(&self) -> usize {
        self.longest
    }

    fn confirms(&self) -> bool {
        self.confirms
    }

    fn notification(&mut self, timeout: Duration) -> std::result::Result<Option<Vec<u8>>, String> {
        match self.notifications.recv_timeout(timeout) {
            Ok(value) => Ok(Some(value)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err("out of range".into()),
        }
    }

    fn write(&mut self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String> {
        let sent = self.written.send((piece.to_vec(), confirmed));
        sent.map_err(|_| "out of range".into())
    }
}

/// The board's end of a [`Fake`].
struct Board {
    notify: Sender<Vec<u8>>,
    written: Receiver<(Vec<u8>, bool)>,
}

fn connection(longest: usize, confirms: bool) -> (Board, NusLink<Fake>) {
    let (notify, notifications) = channel();
    let (sender, written) = channel();
    let fake = Fake { longest, confirms, notifications, written: sender };
    (Board { notify, written }, NusLink::new("ble://wimu-1a2b", fake))
}

const SHORT: Duration = Duration::from_millis(10);

const LONG: Duration = Duration::from_secs(5);

#[test]
fn writes_are_split_at_what_the_connection_carries_and_confirmed_where_it_can_be() {
    let bytes: Vec<u8> = (0..=255).cycle().take(500).collect();
    // A connection that reports less than Bluetooth guarantees is given what it guarantees.
    for (longest, confirms, most) in [(244, true, 244), (20, false, 20), (0, true, 20)] {
        let (board, mut link) = connection(longest, confirms);
        link.write_all(&bytes).unwrap();
        let pieces: Vec<_> = board.written.try_iter().collect();
        assert_eq!(pieces.len(), 500_usize.div_ceil(most));
        assert!(pieces.iter().all(|(piece, _)| piece.len() <= most));
        assert!(pieces.iter().all(|(_, confirmed)| *confirmed == confirms));
        let joined: Vec<u8> = pieces.into_iter().flat_map(|(piece, _)| piece).collect();
        assert_eq!(joined, bytes);
    }
}

#[test]
fn notifications_come_as_a_stream_through_buffers_of_any_length_and_time_out() {
    let (board, mut link) = connection(20, true);
    board.notify.send(vec![1, 2, 3]).unwrap();
    board.notify.send(Vec::new()).unwrap();
    board.notify.send(vec![4]).unwrap();
    let mut buffer = [0; 2];
    let mut received = Vec::new();
    while received.len() < 4 {
        let count = link.read(&mut buffer, LONG).unwrap();
        received.extend_from_slice(&buffer[..count]);
    }
    assert_eq!(received, [1, 2, 3, 4]);
    assert_eq!(link.read(&mut buffer, SHORT).unwrap(), 0);
    assert_eq!(link.read(&mut [], LONG).unwrap(), 0);
}

#[test]
fn a_lost_connection_delivers_what_has_come_and_then_says_what_to_do() {
    let (board, mut link) = connection(20, true);
    board.notify.send(vec![7]).unwrap();
    drop(board);
    let mut buffer = [0; 8];
    assert_eq!(link.read(&mut buffer, LONG).unwrap(), 1);
    for error in [link.read(&mut buffer, LONG).unwrap_err(), link.write_all(&[1]).unwrap_err()] {
        assert_eq!(error.code, Code::LinkLost);
        assert_eq!(error.place.at.as_deref(), Some("ble://wimu-1a2b"));
        assert!(error.text.contains("out of range"), "{error}");
        assert!(error.remedy.contains("connect again"), "{error}");
    }
}
