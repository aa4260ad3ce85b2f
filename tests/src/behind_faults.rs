//! A board of any kind, such as an emulated one, whose wireless link has simulated faults.

use wimu_host::Result;
use wimu_link::LinkRole;
use wimu_sim::board::VirtualBoard;
use wimu_sim::faults::LinkFaults;
use wimu_sim::pipe::Channels;

/// A proxy on the board's wireless line, with a time resolution of a millisecond.
pub struct BehindFaults<R> {
    /// The board.
    pub board: R,
    channels: Channels,
}

impl<R: VirtualBoard> BehindFaults<R> {
    /// The wireless link of `board` gets `faults`; the same seed gives the same faults.
    pub fn new(board: R, faults: &LinkFaults, seed: u64) -> Self {
        let channels = Channels::new(faults, seed);
        Self { board, channels }
    }

    /// The faults with their statistics.
    pub fn channels(&self) -> &Channels {
        &self.channels
    }

    /// Carries the bytes that have arrived on either side.
    fn carry(&mut self) -> Result<()> {
        let now_ns = self.board.now_us() * 1000;
        let sent = self.board.receive(LinkRole::Wireless);
        self.channels.to_host.borrow_mut().push(now_ns, &sent);
        let arrived = self.channels.to_device.borrow_mut().pull(now_ns, usize::MAX);
        if arrived.is_empty() { Ok(()) } else { self.board.send(LinkRole::Wireless, &arrived) }
    }
}

impl<R: VirtualBoard> VirtualBoard for BehindFaults<R> {
    fn run_until(&mut self, time_us: u64) -> Result<()> {
        loop {
            self.carry()?;
            if self.board.now_us() >= time_us {
                return Ok(());
            }
            let step_us = (self.board.now_us() + 1000).min(time_us);
            self.board.run_until(step_us)?;
        }
    }

    fn now_us(&self) -> u64 {
        self.board.now_us()
    }

    fn started_us(&self) -> u64 {
        self.board.started_us()
    }

    fn restart(&mut self) -> Result<()> {
        self.channels.clear();
        self.board.restart()
    }

    fn receive(&mut self, role: LinkRole) -> Vec<u8> {
        let now_ns = self.board.now_us() * 1000;
        match role {
            LinkRole::Cable => self.board.receive(role),
            _ => self.channels.to_host.borrow_mut().pull(now_ns, usize::MAX),
        }
    }

    fn send(&mut self, role: LinkRole, bytes: &[u8]) -> Result<()> {
        let now_ns = self.board.now_us() * 1000;
        match role {
            LinkRole::Cable => self.board.send(role, bytes),
            _ => {
                self.channels.to_device.borrow_mut().push(now_ns, bytes);
                Ok(())
            }
        }
    }

    fn connection(&mut self, role: LinkRole) -> Option<u64> {
        let now_ns = self.board.now_us() * 1000;
        match role {
            LinkRole::Cable => self.board.connection(role),
            _ => self.channels.to_host.borrow().connection(now_ns),
        }
    }
}
