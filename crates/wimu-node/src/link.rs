//! The two halves of a link.

use core::convert::Infallible;
use core::future::pending;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{ErrorType, Read, Write};
use wimu_link::frame::RequestDeframer;
use wimu_link::message::Command;
use wimu_link::responder::Decision;
#[cfg(feature = "auth")]
use wimu_link::tag::{Tag, Tagger};
use wimu_link::{Kind, LinkRole};
use wimu_model::DeviceTimeUs;

use crate::queue::PIECE;
#[cfg(feature = "auth")]
use crate::shared::Message;
use crate::shared::{Common, Worker, runs};
use crate::timer::Timer;

/// Shortest interval between answers to [`Kind::WhoAreYou`], µs.
const INTRODUCED_US: u64 = 250_000;

/// Both halves of a link that the board does not have: nothing arrives, and what is sent is discarded.
pub struct NoLink;

impl ErrorType for NoLink {
    type Error = Infallible;
}

impl Read for NoLink {
    async fn read(&mut self, _: &mut [u8]) -> Result<usize, Infallible> {
        pending().await
    }
}

impl Write for NoLink {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Sends the frames queued for one link.
pub struct LinkWriter<'a, W, M: RawMutex> {
    pub(crate) role: LinkRole,
    pub(crate) line: W,
    pub(crate) shared: &'a Common<M>,
}

impl<W: Write, M: RawMutex> LinkWriter<'_, W, M> {
    /// Runs for ever. A failure of the line loses the current frame; the next one is sent.
    pub async fn run(&mut self) -> ! {
        if runs(self.role) {
            self.send().await
        }
        pending().await
    }

    async fn send(&mut self) -> ! {
        let mut piece = [0; PIECE];
        #[cfg(feature = "auth")]
        let mut tagger = Tagger::new(self.role);
        // Ends a frame that a restart has interrupted.
        let _ = self.line.write_all(&[0]).await;
        loop {
            self.shared.progressed(Worker::Writer(self.role));
            let (length, ended) = self.shared.next_piece(self.role, &mut piece).await;
            let piece = piece.get(..length).unwrap_or_default();
            if self.line.write_all(piece).await.is_err() {
                embassy_futures::yield_now().await;
            }
            #[cfg(feature = "auth")]
            if let Some(tag) = tagger.sent(piece, ended, || self.shared.lock()) {
                self.send_tag(tag).await;
            }
            if ended {
                let _ = self.line.flush().await;
                self.shared.frame_sent(self.role);
            }
        }
    }

    /// Sends a tag, before any other frame.
    #[cfg(feature = "auth")]
    async fn send_tag(&mut self, tag: Tag) {
        let mut frame = [0; Tag::MAX_FRAME];
        let length = Message::Tag(tag).encode(&mut frame).unwrap_or(0);
        let frame = frame.get(..length).unwrap_or_default();
        let _ = self.line.write_all(frame).await;
        self.shared.count_sent(self.role, frame.len());
    }
}

/// Receives on one link: answers [`Kind::WhoAreYou`] and passes accepted requests to [`Control`](crate::Control).
pub struct LinkReader<'a, R, T, M: RawMutex> {
    pub(crate) role: LinkRole,
    pub(crate) line: R,
    pub(crate) timer: T,
    pub(crate) shared: &'a Common<M>,
}

impl<R: Read, T: Timer, M: RawMutex> LinkReader<'_, R, T, M> {
    /// Runs for ever. The line's `read` must be cancel-safe: a cancelled read loses no bytes.
    pub async fn run(&mut self) -> ! {
        if runs(self.role) {
            self.listen().await
        }
        pending().await
    }

    async fn listen(&mut self) -> ! {
        let mut deframer = RequestDeframer::default();
        let mut bytes = [0; 64];
        let mut introduced: Option<DeviceTimeUs> = None;
        loop {
            let read = match self.line.read(&mut bytes).await {
                Ok(read) if read > 0 => read,
                // The line may work again later.
                _ => {
                    self.timer.after_us(10_000).await;
                    continue;
                }
            };
            for &byte in bytes.get(..read).unwrap_or_default() {
                let Some(received) = deframer.push(byte) else {
                    continue;
                };
                match received {
                    Ok(frame) if frame.kind == Kind::WhoAreYou => {
                        // A flood of questions must not displace samples.
                        let now = self.timer.now();
                        if introduced
                            .is_none_or(|last| now.0.saturating_sub(last.0) >= INTRODUCED_US)
                        {
                            introduced = Some(now);
                            self.shared.introduce(self.role, now);
                        }
                    }
                    Ok(frame) if frame.kind == Kind::Request => {
                        let Some(command) = self.accept(frame.body).await else {
                            continue;
                        };
                        self.shared.requests.send((self.role, command)).await;
                    }
                    // Frames of a device, looped back; those longer than a request count as damaged.
                    Ok(_) => {}
                    Err(_) => self.count_damaged(),
                }
            }
        }
    }

    /// The command to execute; a request that needs none is answered here.
    async fn accept(&self, request: &[u8]) -> Option<Command> {
        let lock = self.shared.lock();
        let mut responder = self.shared.responder(self.role).await;
        let command = match responder.accept_at(request, &lock, self.timer.now().0) {
            Decision::Execute(command) => Some(command),
            // If there is no room, the host repeats its request.
            Decision::Send(answer) => {
                self.shared.keep_if_room(self.role, answer);
                None
            }
            Decision::Ignore => None,
        };
        let repeated = responder.repeated();
        self.shared.with_heard(self.role, |heard| heard.repeated = repeated);
        command
    }

    fn count_damaged(&self) {
        self.shared.with_heard(self.role, |heard| {
            heard.damaged = heard.damaged.wrapping_add(1);
        });
    }
}
