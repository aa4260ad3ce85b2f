//! The page of the server: four files, and a WebSocket for each page.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use tokio::time::{sleep, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::create_response_with_body;
use tokio_tungstenite::tungstenite::protocol::{
    CloseFrame, Role, WebSocketConfig, frame::coding::CloseCode,
};
use wimu_host::html;
use wimu_host::serve::{self, Place, Request, Response, Server, StatusCode, header};
use wimu_host::{Result, serve::respond};

use super::access::{Access, Refusal, Target, check};
use super::hub::{Hub, Page};

/// Longest time in which a page takes nothing, and until its first message.
const PATIENCE: Duration = Duration::from_secs(10);
/// Largest message of a page, bytes.
const MOST_MESSAGE: usize = 1 << 16;

const SCRIPT: &str = include_str!("page/dashboard.js");
const PAGE: &str = include_str!("page/index.html");
const STYLE: &str = include_str!("page/style.css");

/// Headers of every answer. What the page may load: its own files and its socket, nothing of elsewhere.
const HEADERS: [(header::HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: blob:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Takes a message of a page; returns what the page may do.
pub type Answers = Arc<dyn Fn(&Arc<Page>, &str) -> Access + Send + Sync>;

/// Answers requests until the server is dropped.
///
/// # Errors
/// Those of [`Server::start`].
pub fn start(address: SocketAddr, hub: Arc<Hub>, answers: Answers) -> Result<Server> {
    let remedy = "give another port with --port, or in --listen; 0 is a free one";
    Server::start(address, remedy, move |request, place| {
        let mut response = match check(&request, place.server) {
            Ok(Target::Socket) => socket(request, place, &hub, &answers),
            Ok(Target::File(file)) => respond(StatusCode::OK, KINDS[file], text(file)),
            Err(refusal) => refuse(refusal),
        };
        for (name, value) in HEADERS {
            response.headers_mut().insert(name, header::HeaderValue::from_static(value));
        }
        response
    })
}

const KINDS: [&str; 4] = [
    "text/html; charset=utf-8",
    "text/css; charset=utf-8",
    "text/javascript; charset=utf-8",
    "text/javascript; charset=utf-8",
];

fn text(file: usize) -> String {
    match file {
        0 => PAGE.to_owned(),
        1 => format!("{}\n{STYLE}", html::STYLE),
        2 => html::PLOT_SCRIPT.to_owned(),
        _ => SCRIPT.to_owned(),
    }
}

fn refuse(refusal: Refusal) -> Response {
    respond(refusal.status(), "text/plain", refusal.status().to_string())
}

/// Begins a WebSocket.
fn socket(request: Request, place: &Arc<Place>, hub: &Arc<Hub>, answers: &Answers) -> Response {
    let Ok(response) = create_response_with_body(&request, Default::default) else {
        return refuse(Refusal::Malformed);
    };
    let upgraded = serve::upgraded(request);
    let (place, hub, answers) = (place.clone(), hub.clone(), answers.clone());
    tokio::spawn(async move {
        let Some(stream) = upgraded.await else { return };
        let config = WebSocketConfig::default()
            .max_message_size(Some(MOST_MESSAGE))
            .max_frame_size(Some(MOST_MESSAGE));
        let socket = WebSocketStream::from_raw_socket(stream, Role::Server, Some(config)).await;
        let page = Arc::new(Page::default());
        tokio::select! {
            _ = talk(socket, &page, &place, &hub, &answers) => {}
            () = place.lost() => {}
        }
        hub.leave(&page);
    });
    response
}

/// Exchanges messages with a page until either end closes. What a page does not take yet stays in its queue, where the
/// oldest frames make room.
async fn talk<S>(
    socket: WebSocketStream<S>,
    page: &Arc<Page>,
    place: &Place,
    hub: &Hub,
    answers: &Answers,
) -> Option<()>
where
    WebSocketStream<S>: StreamExt<Item = std::result::Result<Message, Failed>>
        + SinkExt<Message, Error = Failed>
        + Unpin,
{
    let (mut sink, mut stream) = socket.split();
    let mut first = std::pin::pin!(sleep(PATIENCE));
    loop {
        tokio::select! {
            () = &mut first, if !page.is_admitted() => return None,
            texts = hub.next(page) => for text in texts {
                timeout(PATIENCE, sink.send(Message::text(&*text))).await.ok()?.ok()?;
            },
            message = stream.next() => {
                let Message::Text(text) = message?.ok()? else { continue };
                let (page, answers) = (page.clone(), answers.clone());
                // It may read files.
                let access = tokio::task::spawn_blocking(move || answers(&page, &text));
                match access.await.ok()? {
                    Access::None => {
                        let reason = "the token is wrong or missing".into();
                        let close = CloseFrame { code: CloseCode::Policy, reason };
                        timeout(PATIENCE, sink.send(Message::Close(Some(close)))).await.ok()?.ok()?;
                        return None;
                    }
                    Access::Read => {}
                    Access::Write => place.reserve(),
                }
            }
        }
    }
}

type Failed = tokio_tungstenite::tungstenite::Error;
