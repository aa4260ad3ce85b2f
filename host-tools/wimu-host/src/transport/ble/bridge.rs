//! From asynchronous calls to blocking ones: a connection in a thread of its own.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use futures::StreamExt as _;
use futures::stream::Stream;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

use crate::transport::nus::Peripheral;
use crate::{Code, Result};

/// Interval between two looks whether the connection has ended: not every system ends the stream of values.
const GLANCE: Duration = Duration::from_secs(1);
/// Longest wait for a write.
const PATIENCE: Duration = Duration::from_secs(3);

/// What a Bluetooth stack provides.
#[allow(async_fn_in_trait, reason = "a connection stays in the thread that made it")]
pub trait Connection {
    /// Longest value of one write, bytes.
    fn longest(&self) -> usize;

    /// Whether writes can be confirmed.
    fn confirms(&self) -> bool;

    /// The notified values, once; ends with the connection.
    fn values(&mut self) -> impl Stream<Item = Vec<u8>> + Unpin + use<Self>;

    /// Writes one value.
    async fn write(&self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String>;

    /// Whether the connection exists.
    async fn is_connected(&self) -> bool;

    /// Ends the connection.
    async fn disconnect(&self);
}

/// A write, and where to report its outcome.
struct Order {
    piece: Vec<u8>,
    confirmed: bool,
    done: Sender<std::result::Result<(), String>>,
}

/// A connection in a thread of its own, which ends it when the bridge is dropped.
pub struct Bridge {
    longest: usize,
    confirms: bool,
    orders: UnboundedSender<Order>,
    values: Receiver<Vec<u8>>,
    /// The thread; taken when the bridge is dropped.
    thread: Option<thread::JoinHandle<()>>,
}

/// A runtime for the calling thread.
///
/// # Errors
/// `link_absent` when the system has no resources for one.
pub(super) fn runtime() -> Result<Runtime> {
    let built = Builder::new_current_thread().enable_all().build();
    built.map_err(|error| {
        Code::LinkAbsent.error(
            format!("no runtime for Bluetooth: {error}"),
            "close other programs, then try again",
        )
    })
}

impl Bridge {
    /// Connects in a new thread, and waits until the connection exists.
    ///
    /// # Errors
    /// Those of `connect`.
    pub fn start<C: Connection + 'static>(
        connect: impl AsyncFnOnce() -> Result<C> + Send + 'static,
    ) -> Result<Self> {
        let (orders, received) = unbounded_channel();
        let (notify, values) = channel();
        let (ready, outcome) = channel();
        let thread = thread::spawn(move || {
            let started = runtime().and_then(|runtime| {
                let connection = runtime.block_on(connect())?;
                Ok((runtime, connection))
            });
            match started {
                Ok((runtime, connection)) => {
                    let about = (connection.longest(), connection.confirms());
                    if ready.send(Ok(about)).is_ok() {
                        runtime.block_on(serve(connection, received, notify));
                    }
                }
                // Without a reader there is nothing to report to.
                Err(error) => drop(ready.send(Err(error))),
            }
        });
        let gone = Code::LinkLost.error("the Bluetooth stack failed", "connect again");
        let (longest, confirms) = outcome.recv().unwrap_or(Err(gone))?;
        Ok(Self { longest, confirms, orders, values, thread: Some(thread) })
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        // Without a sender of orders the thread ends the connection: the unit can be found again.
        self.orders = unbounded_channel().0;
        if let Some(thread) = self.thread.take() {
            // A panic in it has been reported by its end.
            let _ = thread.join();
        }
    }
}

/// Passes values and orders until the connection or the bridge ends.
async fn serve(
    mut connection: impl Connection,
    mut orders: UnboundedReceiver<Order>,
    notify: Sender<Vec<u8>>,
) {
    let mut values = connection.values();
    loop {
        tokio::select! {
            value = values.next() => {
                if value.is_none_or(|value| notify.send(value).is_err()) {
                    break;
                }
            }
            order = orders.recv() => {
                let Some(Order { piece, confirmed, done }) = order else {
                    break;
                };
                let written = connection.write(&piece, confirmed).await;
                // The bridge may have lost its patience.
                let _ = done.send(written);
            }
            () = tokio::time::sleep(GLANCE) => {
                if !connection.is_connected().await {
                    break;
                }
            }
        }
    }
    drop(notify);
    connection.disconnect().await;
}

impl Peripheral for Bridge {
    fn longest(&self) -> usize {
        self.longest
    }

    fn confirms(&self) -> bool {
        self.confirms
    }

    fn notification(&mut self, timeout: Duration) -> std::result::Result<Option<Vec<u8>>, String> {
        match self.values.recv_timeout(timeout) {
            Ok(value) => Ok(Some(value)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err("the unit is gone".to_owned()),
        }
    }

    fn write(&mut self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String> {
        let (done, outcome) = channel();
        let order = Order { piece: piece.to_vec(), confirmed, done };
        // Of an ended thread, the answer's channel is closed.
        let _ = self.orders.send(order);
        match outcome.recv_timeout(PATIENCE) {
            Ok(written) => written,
            Err(RecvTimeoutError::Timeout) => Err("the unit does not confirm what it gets".into()),
            Err(RecvTimeoutError::Disconnected) => Err("the unit is gone".to_owned()),
        }
    }
}
