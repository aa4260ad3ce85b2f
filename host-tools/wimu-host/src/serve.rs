//! HTTP server of the dashboard's page and of the gateway's metrics: hyper with time limits, and places that the owner does
//! not share with strangers.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONNECTION, CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::upgrade::Upgraded;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Notify;
use tokio::time::{sleep, timeout};

use crate::{Code, Result};

pub use hyper::{Method, StatusCode, header};

/// A request, of which the server has read the head.
pub type Request<B = Incoming> = hyper::Request<B>;
/// Its answer.
pub type Response = hyper::Response<Full<Bytes>>;

/// Longest time until the head of a request is complete. Chosen: a browser sends it at once.
const HEAD: Duration = Duration::from_secs(5);
/// Longest time until a request is answered and the answer is taken.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest head, bytes: the least that hyper takes.
const MOST_HEAD: usize = 8192;
/// Connections of strangers; one more closes the oldest of them. Half of the usual limit of open files.
const MOST_STRANGERS: usize = 512;
/// Connections that wait to be accepted, after which the operating system drops them: twice the places of strangers.
const MOST_WAITING: u32 = 1024;
/// Shortest time for which a stranger has a place, in which its request must come: TCP's first timeout of a lost packet, RFC
/// 6298. A burst of connections waits for it, since it would otherwise close what was opened just before.
const KEPT: Duration = Duration::from_secs(1);
/// Pause after a failed accept, out of file descriptors, and without a place: others may end.
const RETRY: Duration = Duration::from_millis(10);

/// Takes a request by its head, whose body is never read.
pub trait Answer: Fn(Request, &Arc<Place>) -> Response + Send + Sync + 'static {}

impl<A: Fn(Request, &Arc<Place>) -> Response + Send + Sync + 'static> Answer for A {}

/// A server that answers until it is dropped.
pub struct Server {
    address: SocketAddr,
    _runtime: Runtime,
}

impl Server {
    /// Answers requests at an address; `remedy` says how to give another one.
    ///
    /// # Errors
    /// `link_busy` when the address is in use.
    pub fn start(address: SocketAddr, remedy: &str, answer: impl Answer) -> Result<Self> {
        let failed = |error: io::Error| {
            let message = format!("cannot listen: {error}");
            Code::LinkBusy.error(message, remedy).at(address.to_string())
        };
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(failed)?;
        let listener = runtime.block_on(async { listen(address) }).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let (answer, strangers) = (Arc::new(answer), Arc::default());
        runtime.spawn(async move {
            loop {
                match listener.accept().await {
                    Ok((stream, _)) => {
                        while is_full(&strangers) {
                            sleep(RETRY).await;
                        }
                        let place = Arc::new(Place::take(address, &strangers));
                        tokio::spawn(serve(stream, place, answer.clone()));
                    }
                    Err(_) => sleep(RETRY).await,
                }
            }
        });
        Ok(Self { address, _runtime: runtime })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // Windows gives the address of a running server away with it.
    #[cfg(unix)]
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(MOST_WAITING)
}

/// Answers one request: no connection is kept for a second one.
async fn serve(stream: TcpStream, place: Arc<Place>, answer: Arc<impl Answer>) {
    let _ = stream.set_nodelay(true);
    let service = service_fn(|request| {
        let mut response = answer(request, &place);
        if response.status() != StatusCode::SWITCHING_PROTOCOLS {
            response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
        }
        async { Ok::<_, Infallible>(response) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(MOST_HEAD)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    tokio::select! {
        // A browser that closes a connection is no failure.
        _ = timeout(PATIENCE, connection) => {}
        () = place.lost() => {}
    }
}

/// An answer of this type, such as `text/plain`.
pub fn respond(status: StatusCode, kind: &'static str, body: impl Into<Bytes>) -> Response {
    let mut response = Response::new(Full::new(body.into()));
    *response.status_mut() = status;
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// The connection of a request that is answered by 101, once it is; `None` if it has ended.
pub fn upgraded(request: Request) -> impl Future<Output = Option<TokioIo<Upgraded>>> {
    let upgrade = hyper::upgrade::on(request);
    async { upgrade.await.ok().map(TokioIo::new) }
}

/// Connections that have not proved to be the owner's, by age.
type Strangers = Mutex<BTreeMap<u64, Stranger>>;

struct Stranger {
    since: Instant,
    lost: Arc<Notify>,
}

/// Whether every place is taken, and for less than [`KEPT`].
fn is_full(strangers: &Strangers) -> bool {
    let all = lock(strangers);
    let oldest = all.first_key_value();
    all.len() >= MOST_STRANGERS && oldest.is_some_and(|(_, oldest)| oldest.since.elapsed() < KEPT)
}

/// Place of a connection.
pub struct Place {
    /// Address of the server.
    pub server: SocketAddr,
    number: u64,
    strangers: Arc<Strangers>,
    lost: Arc<Notify>,
}

impl Place {
    fn take(server: SocketAddr, strangers: &Arc<Strangers>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let (number, lost) = (NEXT.fetch_add(1, Ordering::Relaxed), Arc::new(Notify::new()));
        let mut all = lock(strangers);
        all.insert(number, Stranger { since: Instant::now(), lost: lost.clone() });
        if all.len() > MOST_STRANGERS
            && let Some((_, oldest)) = all.pop_first()
        {
            oldest.lost.notify_one();
        }
        Self { server, number, strangers: strangers.clone(), lost }
    }

    /// Reserves it: the other end has the token, and no stranger closes it.
    pub fn reserve(&self) {
        lock(&self.strangers).remove(&self.number);
    }

    /// Completes when a newer connection has taken the place.
    pub async fn lost(&self) {
        self.lost.notified().await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.reserve();
    }
}

/// Locks a mutex, also after another thread has panicked while it held the lock.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
