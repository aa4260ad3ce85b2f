//! A Bluetooth connection in a thread of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use futures::channel::mpsc;
use futures::stream::Stream;
use wimu_host::Code;
use wimu_host::transport::Transport;
use wimu_host::transport::ble::{Bridge, Connection};
use wimu_host::transport::nus::NusLink;

/// A connection in memory.
struct Fake {
    values: Option<mpsc::UnboundedReceiver<Vec<u8>>>,
    written: Sender<(Vec<u8>, bool)>,
    is_connected: Arc<AtomicBool>,
    disconnected: Sender<()>,
}

/// The unit at the other end.
struct Unit {
    notify: mpsc::UnboundedSender<Vec<u8>>,
    written: Receiver<(Vec<u8>, bool)>,
    is_connected: Arc<AtomicBool>,
    disconnected: Receiver<()>,
}

impl Connection for Fake {
    fn longest(&self) -> usize {
        100
    }

    fn confirms(&self) -> bool {
        true
    }

    fn values(&mut self) -> impl Stream<Item = Vec<u8>> + Unpin + use<> {
        self.values.take().unwrap()
    }

    async fn write(&self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String> {
        tokio::time::sleep(Duration::from_millis(1)).await;
        let sent = self.written.send((piece.to_vec(), confirmed));
        sent.map_err(|_| "refused".to_owned())
    }

    async fn is_connected(&self) -> bool {
        self.is_connected.load(Ordering::Relaxed)
    }

    async fn disconnect(&self) {
        let _ = self.disconnected.send(());
    }
}

fn connected() -> (Unit, NusLink<Bridge>) {
    let (notify, values) = mpsc::unbounded();
    let (writes, written) = channel();
    let (ended, disconnected) = channel();
    let is_connected = Arc::new(AtomicBool::new(true));
    let fake = Fake {
        values: Some(values),
        written: writes,
        is_connected: is_connected.clone(),
        disconnected: ended,
    };
    let unit = Unit { notify, written, is_connected, disconnected };
    let bridge = Bridge::start(async move || Ok(fake)).unwrap();
    (unit, NusLink::new("ble://wimu-1a2b", bridge))
}

const LONG: Duration = Duration::from_secs(20);

#[test]
fn blocking_calls_reach_an_asynchronous_connection_and_its_values_come_back() {
    let (unit, mut link) = connected();
    for round in 0..20 {
        link.write_all(&[round; 250]).unwrap();
        let lengths = [100, 100, 50];
        for length in lengths {
            let expected = (vec![round; length], true);
            assert_eq!(unit.written.recv_timeout(LONG).unwrap(), expected);
        }
        unit.notify.unbounded_send(vec![round; 3]).unwrap();
        let mut buffer = [0; 8];
        assert_eq!(link.read(&mut buffer, LONG).unwrap(), 3);
        assert_eq!(buffer[..3], [round; 3]);
    }
    let mut buffer = [0; 8];
    assert_eq!(link.read(&mut buffer, Duration::ZERO).unwrap(), 0);
}

#[test]
fn a_dropped_link_ends_its_connection_so_that_the_unit_can_be_found_again() {
    let (unit, link) = connected();
    drop(link);
    assert_eq!(unit.disconnected.recv_timeout(LONG), Ok(()));
    let (unit, mut link) = connected();
    link.write_all(&[1]).unwrap();
    assert_eq!(unit.written.recv_timeout(LONG).unwrap().0, [1]);
}

#[test]
fn a_connection_that_ends_is_an_error_of_reads_and_writes_however_the_system_shows_it() {
    for stream_ends in [true, false] {
        let (unit, mut link) = connected();
        let Unit { notify, written, is_connected, .. } = unit;
        notify.unbounded_send(vec![9]).unwrap();
        let kept = if stream_ends { None } else { Some(notify) };
        is_connected.store(false, Ordering::Relaxed);
        let mut buffer = [0; 8];
        assert_eq!(link.read(&mut buffer, LONG).unwrap(), 1);
        let error = link.read(&mut buffer, LONG).unwrap_err();
        assert_eq!(error.code, Code::LinkLost);
        let error = link.write_all(&[1]).unwrap_err();
        assert!(error.text.contains("gone"), "{error}");
        drop((kept, written));
    }
}

#[test]
fn a_write_that_the_system_refuses_is_reported_with_its_reason() {
    let (unit, mut link) = connected();
    drop(unit.written);
    let error = link.write_all(&[1]).unwrap_err();
    assert!(error.text.contains("refused"), "{error}");
}

#[test]
fn a_unit_that_does_not_connect_is_reported() {
    let absent = || Code::LinkAbsent.error("not in range", "come closer");
    let outcome = Bridge::start::<Fake>(async move || Err(absent()));
    assert_eq!(outcome.err(), Some(absent()));
}
