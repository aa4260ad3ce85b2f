//! Reading the log: which items are valid, and how far they can be relied on.

use embedded_storage_async::nor_flash::NorFlash;

use super::directory::{ENTRY_BYTES, Entry};
use super::item::{HEAD, Word};
use super::{DIRECTORY, FlashStore, MARK, WORD};
use crate::store::StoreFault;

/// Times that an item of a foreign page is read again before it is accepted. Chosen in the campaign `storage`.
const CONFIRMATIONS: usize = 8;

/// Reliability of an item, ascending.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Rank {
    /// There is no item.
    None,
    /// It is accepted only if a directory lists its generation.
    Listed,
    /// A directory follows it in its page.
    Directory,
    /// A seal with this number follows it in its page.
    Sealed(u32),
}

/// What a page holds.
pub(super) struct PageState {
    /// Address at which its items start.
    pub(super) begin: u32,
    /// End of the last byte written.
    pub(super) end: u32,
    /// End of its last directory; 0 without one.
    directory: u32,
    /// End of its last seal; 0 without one.
    pub(super) seal: u32,
    /// Latest number of its directories.
    serial: u32,
    /// Latest number of its seals.
    seal_serial: u32,
    /// Number of its seals.
    seals: u32,
    /// Written by firmware that used `sequential-storage`, or not written.
    is_foreign: bool,
}

impl PageState {
    fn is_finished(&self) -> bool {
        self.seal == self.end
    }

    /// Whether the page is empty or finished.
    pub(super) fn is_settled(&self) -> bool {
        self.end == self.begin || self.is_finished()
    }

    /// Reliability of an item that ends at `end`; `None` if it is not accepted. `newest_seal` is the latest
    /// number of a seal. An unfinished page older than that has been copied. Of a foreign page, the items
    /// that a directory lists are accepted.
    pub(super) fn rank(&self, end: u32, newest_seal: u32) -> Option<Rank> {
        // A page's only seal may be a partly written item. It is accepted only if the latest survey also read it.
        let is_unconfirmed = self.seals == 1 && self.seal_serial > newest_seal;
        if self.seal == 0 {
            let rank = if newest_seal == 0 { Rank::Directory } else { Rank::Listed };
            self.is_foreign.then_some(rank)
        } else if is_unconfirmed || !self.is_finished() && self.serial < newest_seal {
            None
        } else if end <= self.seal {
            Some(Rank::Sealed(self.seal_serial))
        } else if end <= self.directory {
            Some(Rank::Directory)
        } else {
            Some(Rank::Listed)
        }
    }

    /// Whether items of the page are accepted.
    pub(super) fn is_accepted(&self, newest_seal: u32) -> bool {
        self.rank(0, newest_seal).is_some()
    }
}

impl<F: NorFlash> FlashStore<F> {
    /// Reads all items of a page.
    pub(super) async fn page_state(&mut self, page: u32) -> Result<PageState, StoreFault> {
        let begin = page + Self::UNIT as u32;
        let mut first = Word([MARK; WORD]);
        let bytes = first.0.get_mut(..Self::UNIT).unwrap_or_default();
        Self::read(&mut self.flash, page, bytes).await?;
        let mut state = PageState {
            begin,
            end: self.written_end(begin..Self::limit(page)).await?,
            directory: 0,
            seal: 0,
            serial: 0,
            seal_serial: 0,
            seals: 0,
            is_foreign: first.0 != [MARK; WORD],
        };
        let mut at = begin;
        while let Some((item, end)) = self.next_item(at, state.end).await? {
            (at, state.end) = (end, state.end.max(end));
            if item.key == DIRECTORY {
                state.directory = end;
                state.serial = state.serial.max(item.generation);
                if !item.exists {
                    state.seal = end;
                    state.seal_serial = state.serial;
                    state.seals += 1;
                }
            }
        }
        Ok(state)
    }

    /// Reads the whole flash.
    pub(super) async fn survey(&mut self) -> Result<(), StoreFault> {
        self.is_known = false;
        self.survey_pages().await?;
        self.sealed.clear();
        if self.has_unfinished {
            self.survey_records(Self::is_sealed).await?;
            for entry in self.directory.entries.iter().filter(|entry| entry.at > 0) {
                // There is room for all keys.
                let _ = self.sealed.push(entry.at);
            }
        }
        self.survey_records(|_| true).await?;
        self.is_known = true;
        Ok(())
    }

    fn is_sealed(rank: Rank) -> bool {
        matches!(rank, Rank::Sealed(_))
    }

    /// Reads the generations of the records, then where their items are.
    async fn survey_records(&mut self, is_read: fn(Rank) -> bool) -> Result<(), StoreFault> {
        self.directory.entries.clear();
        self.is_empty = true;
        self.survey_items(is_read, Self::note_generation).await?;
        self.survey_items(is_read, Self::note_position).await
    }

    async fn survey_pages(&mut self) -> Result<(), StoreFault> {
        self.newest_seal = 0;
        self.page = None;
        self.has_unfinished = false;
        let mut foreign = 0;
        for page in self.pages() {
            let state = self.page_state(page).await?;
            self.has_unfinished |= !state.is_settled();
            if state.seal_serial >= self.newest_seal {
                self.newest_seal = state.seal_serial;
                self.page = state.is_finished().then_some(page);
                self.end = state.end;
                self.single_seal = (state.seals == 1).then_some(page);
            }
            let is_blank = self.written_end(page..page + Self::PAGE).await? == page;
            foreign += u32::from(state.is_foreign && !is_blank);
        }
        self.serial = self.newest_seal;
        // A single page without valid items may be the interrupted first change of a new flash.
        self.is_corrupt = foreign > 1;
        Ok(())
    }

    /// Calls `note` for every accepted item of the ranks that are read.
    async fn survey_items(
        &mut self,
        is_read: fn(Rank) -> bool,
        note: fn(&mut Self, Entry) -> Result<(), StoreFault>,
    ) -> Result<(), StoreFault> {
        for page in self.pages() {
            let state = self.page_state(page).await?;
            let mut at = state.begin;
            while let Some((item, end)) = self.next_item(at, state.end).await? {
                at = end;
                if let Some(rank) = state.rank(end, self.newest_seal)
                    && is_read(rank)
                    && (!state.is_foreign || self.is_stable(&item).await?)
                {
                    self.is_corrupt = false;
                    self.is_empty = false;
                    note(self, Entry { rank, ..item })?;
                }
            }
        }
        Ok(())
    }

    /// Whether an item reads the same every time; its data is in the buffer afterwards. A page of this firmware whose erase
    /// was interrupted can look like a foreign one, with copies that can be read only now and then: if they were preferred
    /// to those of another page, that page would be erased.
    async fn is_stable(&mut self, item: &Entry) -> Result<bool, StoreFault> {
        for _ in 0..CONFIRMATIONS {
            let again = self.item(item.at).await?;
            let again = again.map(|again| (again.key, again.generation, again.length));
            if again != Some((item.key, item.generation, item.length)) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Takes the generations of an item, whose data is in the buffer.
    fn note_generation(&mut self, item: Entry) -> Result<(), StoreFault> {
        if item.key == DIRECTORY {
            self.serial = self.serial.max(item.generation);
            let listed = self.buffer.0.get(HEAD..HEAD + usize::from(item.length));
            for entry in listed.unwrap_or_default().as_chunks::<ENTRY_BYTES>().0 {
                self.directory.insert_newer(Entry::from_bytes(entry))?;
            }
            Ok(())
        } else if item.rank == Rank::Listed {
            Ok(())
        } else {
            self.directory.insert_newer(item.without_item())
        }
    }

    /// Takes the position of an item if it is the latest generation, and the most reliable copy of it.
    fn note_position(&mut self, item: Entry) -> Result<(), StoreFault> {
        let known = self.directory.entry(item.key);
        let is_latest = (known.generation, known.exists) == (item.generation, item.exists);
        let is_better = item.rank > known.rank || item.rank == known.rank && self.prefers_last;
        if item.key != DIRECTORY && is_latest && is_better {
            self.directory.insert(item)?;
        }
        Ok(())
    }
}
