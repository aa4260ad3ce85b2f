//! Moving records between pages: for room, and to repair pages that power loss left unfinished.

use embedded_storage_async::nor_flash::NorFlash;

use super::directory::Entry;
use super::item::{HEAD, Word};
use super::recovery::Rank;
use super::{FlashStore, MARK, REMOVAL_DIRECTORIES, WORD};
use crate::store::StoreFault;

impl<F: NorFlash> FlashStore<F> {
    /// Reads the flash if its content is not known, and repairs it, so that every later survey gives the
    /// same result.
    pub(super) async fn recover(&mut self) -> Result<(), StoreFault> {
        if self.is_known {
            return Ok(());
        }
        self.survey().await?;
        // A worn-out flash that cannot be repaired can still be read.
        if let Some(page) = self.single_seal
            && self.end + Self::overhead(0) as u32 <= Self::limit(page)
        {
            self.page = Some(page);
            self.secured = None;
            self.serial = self.newest_seal;
            let _ = self.seal().await;
            self.survey().await?;
        }
        if self.has_unfinished && !self.is_corrupt && self.finish_pages().await.is_err() {
            self.survey().await?;
        }
        Ok(())
    }

    /// Copies the records in use out of unfinished pages, and erases these.
    async fn finish_pages(&mut self) -> Result<(), StoreFault> {
        for _ in 0..=2 * self.pages().count() {
            if !self.has_unfinished {
                return Ok(());
            }
            let source = self.unfinished_page().await?;
            let is_free = |page| self.used_in(page) == 0;
            match source {
                // Two pages of earlier firmware may hold copies of the same records, and one of the pages all
                // records: prefer the first copy, so that the other page becomes free.
                Some(_) if self.prefers_last && !self.pages().any(is_free) => {
                    self.prefers_last = false;
                    self.survey().await?;
                }
                // A record could not be copied: the next survey may find another copy of it.
                Some(page) => {
                    if self.compact(Some(page)).await.is_err() {
                        self.survey().await?;
                    }
                }
                None => self.survey().await?,
            }
        }
        Ok(())
    }

    /// The unfinished page to copy next: the one with the fewest bytes in use, one without any only if
    /// there is no other. Pages without accepted items are erased.
    async fn unfinished_page(&mut self) -> Result<Option<u32>, StoreFault> {
        let mut best = None;
        for page in self.pages() {
            let state = self.page_state(page).await?;
            if state.is_settled() {
                continue;
            }
            let used = self.used_in(page).wrapping_sub(1);
            let is_unused = used == usize::MAX;
            let is_copied = is_unused && state.seal == 0 && (self.newest_seal > 0 || self.is_empty);
            if is_copied || !state.is_accepted(self.newest_seal) {
                // The page's items are not accepted, even if this fails.
                let _ = self.erase(page).await;
            } else if best.is_none_or(|(least, _)| used < least) {
                best = Some((used, page));
            }
        }
        Ok(best.map(|(_, page)| page))
    }

    /// Begins a page and copies the records in use of `source` into it; by default of the page that will be
    /// erased next. Records elsewhere that no seal follows are copied too.
    pub(super) async fn compact(&mut self, source: Option<u32>) -> Result<(), StoreFault> {
        let begun = self.begin_page(source.or(self.page)).await?;
        let source = source.unwrap_or_else(|| self.after(begun));
        self.copy(|entry| Self::page_of(entry.at) == source).await?;
        self.copy(|entry| {
            Self::page_of(entry.at) != source && !matches!(entry.rank, Rank::Sealed(_))
        })
        .await?;
        // Skip one number: an interrupted directory may have used it.
        self.serial = self.serial.saturating_add(1);
        self.append_directories(REMOVAL_DIRECTORIES).await?;
        self.seal().await?;
        self.survey().await
    }

    /// Copies the records in use that `is_copied` chooses, as far as there is room. One that cannot be read any more is an
    /// error: no seal follows, and the page that it was in is kept.
    async fn copy(&mut self, is_copied: impl Fn(&Entry) -> bool) -> Result<(), StoreFault> {
        let room = Self::limit(self.page.ok_or(StoreFault)?) - Self::OPENING as u32;
        for index in 0..self.directory.entries.len() {
            let Some(&entry) = self.directory.entries.get(index) else {
                break;
            };
            let fits = self.end + Self::footprint(entry.length) as u32 <= room;
            if entry.at > 0 && fits && is_copied(&entry) {
                self.item(entry.at).await?.ok_or(StoreFault)?;
                self.append(HEAD + usize::from(entry.length)).await?;
            }
        }
        Ok(())
    }

    /// Erases and begins the first page after `kept` that holds no record in use, else the one with the
    /// fewest bytes in use.
    async fn begin_page(&mut self, kept: Option<u32>) -> Result<u32, StoreFault> {
        let mut page = kept.map_or(self.range.start, |kept| self.after(kept));
        let mut best = None;
        for _ in self.pages() {
            if kept != Some(page) {
                let state = self.page_state(page).await?;
                let is_unfinished = !state.is_settled() && state.is_accepted(self.newest_seal);
                let is_needed = is_unfinished || self.page == Some(page);
                let cost = 2 * self.used_in(page) + usize::from(is_needed);
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, page));
                }
            }
            page = self.after(page);
        }
        let (_, page) = best.ok_or(StoreFault)?;
        self.erase(page).await?;
        let mark = Word([MARK; WORD]);
        let mark = mark.0.get(..Self::UNIT).unwrap_or_default();
        Self::write(&mut self.flash, page, mark).await?;
        self.page = Some(page);
        self.end = page + Self::UNIT as u32;
        self.secured = Some(page);
        Ok(page)
    }
}
