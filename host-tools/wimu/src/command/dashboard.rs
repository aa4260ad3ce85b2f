//! `wimu dashboard`: a page on this computer.

mod access;
mod actions;
mod board;
mod folder;
mod hub;
mod path;
mod replay;
mod samples;
mod server;

use std::collections::BTreeSet;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use serde::Deserialize;
use serde_json::json;
use wimu_host::live::LiveClient;
use wimu_host::serve::lock;
use wimu_host::transport;
use wimu_host::{Code, Input, LinkUrl, Problem, Result, client};

use self::access::{Access, Token};
use self::actions::{Action, Job};
use self::board::Board;
use self::folder::{Folder, Piece};
use self::hub::{Asker, Hub, Page};
use self::replay::Player;
use crate::arguments::Dashboard;
use crate::command::{deadline, interrupted, is_over};
use crate::output::{Output, usage};

/// Interval between attempts to connect.
const TRY_EVERY: Duration = Duration::from_secs(1);
/// Interval between updates of the list of files.
const LIST_EVERY: Duration = Duration::from_secs(2);
/// Most boards and files of a dashboard.
const MOST_BOARDS: usize = 32;

pub fn run(arguments: &Dashboard, output: &Output) -> Result<()> {
    let (mut links, mut files) = (Vec::new(), Vec::new());
    for input in &arguments.inputs {
        match Input::parse(input)? {
            Input::Link(url) => links.push(url),
            Input::Recording(path) | Input::File(path) => files.push(path),
        }
    }
    let folder = Folder::new(&arguments.folder, files.clone())?;
    let address =
        arguments.listen.unwrap_or(SocketAddr::from((Ipv4Addr::LOCALHOST, arguments.port)));
    let desk = Arc::new(Desk {
        hub: Arc::new(Hub::default()),
        folder: Arc::new(folder),
        token: Token::generate()?,
        open_reads: address.ip().is_loopback(),
        boards: Mutex::default(),
        waiting: Mutex::default(),
    });
    let answers = desk.clone();
    let answers = move |page: &Arc<Page>, text: &str| answers.take(page, text);
    let server = server::start(address, desk.hub.clone(), Arc::new(answers))?;
    desk.hub.publish(
        "about",
        &json!({
            "version": env!("CARGO_PKG_VERSION"),
            "folder": desk.folder.path().display().to_string(),
        }),
    );
    desk.hub.publish("files", &desk.folder.list());
    for link in links {
        desk.connect(link);
    }
    for file in files {
        let name = file.display().to_string();
        desk.open(&name, &file);
        if let Input::Recording(path) = Input::parse(&name)? {
            desk.play(&name, &path)?;
        }
    }
    let url = url(server.address(), desk.token.text());
    let readers = if address.ip().is_loopback() {
        "The page is for this computer only; what follows # allows writes."
    } else {
        "Other computers reach it at this computer's address; what follows # allows them to read and write, in plaintext."
    };
    output.print(format!("open {url}\n{readers} Ctrl-C ends it."));
    output.object(&json!({ "url": url }));
    if arguments.open {
        show(&url)?;
    }
    let stop = interrupted()?;
    let end = deadline(arguments.seconds);
    let mut listed = Instant::now();
    while !is_over(end, &stop) {
        thread::sleep(Duration::from_millis(50));
        if listed.elapsed() >= LIST_EVERY {
            listed = Instant::now();
            desk.hub.publish("files", &desk.folder.list());
        }
    }
    desk.close();
    Ok(())
}

/// The page's address. Of all interfaces, this computer's own is named.
fn url(address: SocketAddr, token: &str) -> String {
    let host = match address.ip() {
        ip if ip.is_unspecified() => SocketAddr::from((Ipv4Addr::LOCALHOST, address.port())),
        _ => address,
    };
    format!("http://{host}/#{token}")
}

/// Opens a page in the browser of this computer.
fn show(url: &str) -> Result<()> {
    let (program, before) = match std::env::consts::OS {
        "macos" => ("open", &[][..]),
        "windows" => ("cmd", &["/C", "start", ""][..]),
        _ => ("xdg-open", &[][..]),
    };
    let mut command = std::process::Command::new(program);
    let started = command.args(before).arg(url).spawn();
    started.map(drop).map_err(|error| {
        let message = format!("no browser was found: {program}: {error}");
        Code::FileFailed.error(message, "open the printed address yourself")
    })
}

/// A message of a page.
#[derive(Deserialize)]
struct Message {
    #[serde(default)]
    token: String,
    #[serde(default)]
    id: u64,
    /// About this board, or about none.
    board: Option<usize>,
    #[serde(flatten)]
    what: serde_json::Value,
}

/// A request about no board.
#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum General {
    /// The first message of a page.
    Hello,
    Connect {
        link: String,
    },
    /// Give up a link that does not answer.
    Forget {
        link: String,
    },
    Ports,
    /// Show what a file holds.
    Open {
        file: String,
    },
    Play {
        file: String,
    },
    /// A piece of a file that was dropped on the page.
    Upload(Piece),
}

/// A board, as the desk knows it.
struct Seat {
    /// Its number, where it is known, and the roles of its links.
    device_id: Option<u64>,
    roles: Vec<wimu_link::LinkRole>,
    jobs: Sender<Job>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Seat {
    fn is_running(&self) -> bool {
        let thread = self.thread.as_ref();
        thread.is_some_and(|thread| !thread.is_finished())
    }
}

/// All boards, and what pages may ask.
struct Desk {
    hub: Arc<Hub>,
    folder: Arc<Folder>,
    token: Token,
    /// Whether a page without the token may read.
    open_reads: bool,
    boards: Mutex<Vec<Seat>>,
    /// Links that do not answer yet.
    waiting: Mutex<BTreeSet<String>>,
}

impl Desk {
    /// Connects in a thread, again and again until the link answers or is given up.
    fn connect(self: &Arc<Self>, link: LinkUrl) {
        let (desk, name) = (self.clone(), link.to_string());
        if !lock(&self.waiting).insert(name.clone()) {
            return;
        }
        let topic = format!("link/{name}");
        self.hub.publish(&topic, &json!({"link": name, "error": null}));
        thread::spawn(move || {
            let connected = || {
                let client = client::connect(&link)?;
                Ok((client.name().parse()?, client))
            };
            loop {
                let outcome = connected();
                // A link that was given up meanwhile is closed again.
                if !lock(&desk.waiting).contains(&name) {
                    break;
                }
                match outcome {
                    Ok((url, client)) => {
                        lock(&desk.waiting).remove(&name);
                        desk.seat(url, client);
                        break;
                    }
                    Err(error) => {
                        let error: Problem = error;
                        let value = json!({"link": name, "error": error.text});
                        desk.hub.publish(&topic, &value);
                        thread::sleep(TRY_EVERY);
                    }
                }
            }
            desk.hub.withdraw(&topic);
        });
    }

    /// Gives a connected link its board: a new one, or that of its other link.
    fn seat(&self, url: LinkUrl, client: LiveClient) {
        let (id, role) = (client.hello().device_id, client.hello().role);
        let mut boards = lock(&self.boards);
        let other = boards.iter_mut().find(|seat| {
            seat.is_running() && seat.device_id == Some(id) && !seat.roles.contains(&role)
        });
        if let Some(seat) = other {
            seat.roles.push(role);
            let _ = seat.jobs.send(Job::Join(url, Box::new(client)));
            return;
        }
        let name = url.to_string();
        self.sit(&mut boards, &name, Some(id), vec![role], |board, jobs| {
            board.live(url, client, &jobs);
        });
    }

    fn sit(
        &self,
        boards: &mut Vec<Seat>,
        name: &str,
        device_id: Option<u64>,
        roles: Vec<wimu_link::LinkRole>,
        run: impl FnOnce(Board, mpsc::Receiver<Job>) + Send + 'static,
    ) {
        let (jobs, receiver) = mpsc::channel();
        let board = Board::new(boards.len(), name, self.hub.clone(), self.folder.clone());
        let thread = thread::spawn(move || run(board, receiver));
        boards.push(Seat { device_id, roles, jobs, thread: Some(thread) });
    }

    /// Shows what a file holds, read in a thread of its own.
    fn open(self: &Arc<Self>, name: &str, path: &Path) {
        let (desk, name, path) = (self.clone(), name.to_owned(), path.to_owned());
        thread::spawn(move || folder::show(&desk.hub, &format!("file/{name}"), &name, &path));
    }

    /// Replays a recording of wimu.
    fn play(&self, name: &str, path: &Path) -> Result<()> {
        let player = Player::open(path)?;
        let mut boards = lock(&self.boards);
        self.sit(&mut boards, name, None, Vec::new(), |board, jobs| {
            board.replay(player, &jobs);
        });
        Ok(())
    }

    fn has_room(&self) -> Result<()> {
        let boards = lock(&self.boards);
        let running = boards.iter().filter(|seat| seat.is_running()).count();
        if running + lock(&self.waiting).len() < MOST_BOARDS {
            return Ok(());
        }
        Err(usage("there are too many boards", "close one of them"))
    }

    fn general(self: &Arc<Self>, what: General) -> Result<serde_json::Value> {
        match what {
            General::Hello => {}
            General::Connect { link } => {
                let Input::Link(url) = Input::parse(&link)? else {
                    let remedy = "give tcp://HOST:PORT, a serial port or auto";
                    return Err(usage("this is no LINK", remedy));
                };
                self.has_room()?;
                self.connect(url);
            }
            General::Forget { link } => {
                lock(&self.waiting).remove(&link);
            }
            General::Ports => {
                let ports = transport::ports()?;
                return Ok(json!(ports.iter().map(|port| &port.path).collect::<Vec<_>>()));
            }
            General::Open { file } => self.open(&file, &self.folder.file(&file)?),
            General::Play { file } => {
                self.has_room()?;
                self.play(&file, &self.folder.file(&file)?)?;
            }
            General::Upload(piece) => {
                if let Some(name) = self.folder.receive(&piece)? {
                    self.hub.publish("files", &self.folder.list());
                    self.open(name, &self.folder.file(name)?);
                }
            }
        }
        Ok(serde_json::Value::Null)
    }

    /// Ends all boards; a recording is closed.
    fn close(&self) {
        let page = Arc::new(Page::default());
        let mut boards = lock(&self.boards);
        for seat in boards.iter() {
            let asker = Asker { page: page.clone(), id: 0 };
            let _ = seat.jobs.send(Job::Do(Action::Close, asker));
        }
        for thread in boards.iter_mut().filter_map(|seat| seat.thread.take()) {
            let _ = thread.join();
        }
    }

    fn done(
        self: &Arc<Self>,
        message: Message,
        asker: &Asker,
    ) -> Result<Option<serde_json::Value>> {
        let unknown = |error: serde_json::Error| {
            usage(format!("unknown request: {error}"), "reload the page")
        };
        let Some(board) = message.board else {
            let what: General = serde_json::from_value(message.what).map_err(unknown)?;
            return self.general(what).map(Some);
        };
        let action: Action = serde_json::from_value(message.what).map_err(unknown)?;
        let boards = lock(&self.boards);
        let sent = boards.get(board).map(|seat| seat.jobs.send(Job::Do(action, asker.clone())));
        match sent {
            Some(Ok(())) => Ok(None),
            _ => Err(usage("this board was closed", "connect it again")),
        }
    }

    /// Takes a message of a page; returns what the page may do.
    fn take(self: &Arc<Self>, page: &Arc<Page>, text: &str) -> Access {
        let parsed: std::result::Result<Message, _> = serde_json::from_str(text);
        let Ok(message) = parsed else {
            return if page.is_admitted() { Access::Read } else { Access::None };
        };
        let asker = Asker { page: page.clone(), id: message.id };
        let writes = self.token.is(&message.token);
        // A wrong token is never taken for none.
        let may_read = self.open_reads && message.token.is_empty();
        if !writes && !may_read {
            return Access::None;
        }
        let access = if writes { Access::Write } else { Access::Read };
        if message.what["do"] == "hello" {
            self.hub.join(page);
            asker.answer(Ok(json!({"writes": writes})));
            return access;
        }
        if !writes {
            asker.answer(Err::<(), _>(usage(
                "this page may only read: it was opened without the token",
                "open the address that `wimu dashboard` has printed",
            )));
            return access;
        }
        match self.done(message, &asker) {
            Ok(Some(value)) => asker.answer(Ok(value)),
            Ok(None) => {}
            Err(error) => asker.answer(Err::<(), _>(error)),
        }
        access
    }
}
