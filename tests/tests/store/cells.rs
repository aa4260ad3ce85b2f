//! Flash whose cells read differently each time after power was lost while they were changed, and flash
//! whose pages carry any marks.

use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

use super::*;

const PAGE: usize = 4096;
/// Flash of up to four pages. Each bit of a unit whose programming was interrupted, and of a page whose
/// erase was, reads as before or as after, until it is programmed to 0 or its page is erased.
#[derive(Clone)]
struct Cells(Rc<RefCell<Chip>>);

#[derive(Clone)]
struct Chip {
    /// What each byte was before a change, and what it is after; both are the same if it is certain.
    before: Vec<u8>,
    after: Vec<u8>,
    doubt: Vec<Doubt>,
    /// What is programmed at once, bytes: a word, as on an nRF52, or a page of an RP2040's flash.
    unit: usize,
    source: Random,
    /// Units and pages that can be changed before power is lost.
    left: Option<u64>,
    changed: u64,
}

/// How bytes read whose change was interrupted.
#[derive(Clone, Copy, Debug)]
enum Doubt {
    /// Each bit either way.
    Even,
    /// One bit in 32 as after the change, or as before.
    HardlyChanged,
    NearlyChanged,
    /// All alike in one read.
    Whole,
    /// Each bit either way, also those that were not to be changed.
    AllBits,
}

impl Cells {
    fn new(unit: usize, image: &[u8], seed: u64) -> Self {
        Self(Rc::new(RefCell::new(Chip {
            before: image.to_vec(),
            after: image.to_vec(),
            doubt: vec![Doubt::Even; image.len()],
            unit,
            source: Random::new(seed),
            left: None,
            changed: 0,
        })))
    }

    /// Another of the same, whose doubtful cells read in another way.
    fn copy(&self, seed: u64) -> Self {
        let mut chip = self.0.borrow().clone();
        chip.source = Random::new(seed);
        chip.changed = 0;
        Self(Rc::new(RefCell::new(chip)))
    }

    fn lose_power_after(&self, changes: Option<u64>) {
        self.0.borrow_mut().left = changes;
    }

    fn start(&self) -> FlashStore<Self> {
        const TWO: FlashLayout<Cells> = FlashLayout::new(0..2 * PAGE as u32);
        const FOUR: FlashLayout<Cells> = FlashLayout::new(0..4 * PAGE as u32);
        let layout = match self.0.borrow().before.len() / PAGE {
            2 => TWO,
            _ => FOUR,
        };
        FlashStore::new(self.clone(), layout, 0)
    }

    /// What a store finds that has just started; `None` when power was lost.
    fn held(&self) -> Option<Result<Model, StoreFault>> {
        let mut store = self.start();
        let mut model = Model::new();
        let mut record = [0; MAX_RECORD];
        for key in KEYS {
            match done(store.load(key, &mut record))? {
                Ok(None) => {}
                Ok(Some(length)) => drop(model.insert(number(key), record[..length].to_vec())),
                Err(fault) => return Some(Err(fault)),
            }
        }
        Some(Ok(model))
    }
}

impl Chip {
    /// Changes bytes; false when power is lost meanwhile.
    fn change(&mut self, at: usize, length: usize, change: impl Fn(usize, u8) -> u8) -> bool {
        let interrupted = self.left == Some(0);
        let doubt = [
            Doubt::Even,
            Doubt::HardlyChanged,
            Doubt::NearlyChanged,
            Doubt::Whole,
            Doubt::AllBits,
        ][self.source.below(5)];
        for index in 0..length {
            let (before, after) = (&mut self.before[at + index], &mut self.after[at + index]);
            if !interrupted {
                *before = change(index, *before);
                *after = change(index, *after);
                continue;
            }
            *after = match doubt {
                Doubt::AllBits => !*before,
                _ => change(index, *after),
            };
            self.doubt[at + index] = doubt;
        }
        self.left = self.left.map(|left| left.saturating_sub(1));
        self.changed += 1;
        !interrupted
    }
}

impl ErrorType for Cells {
    type Error = Infallible;
}

impl ReadNorFlash for Cells {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        let chip = &mut *self.0.borrow_mut();
        let range = offset as usize..offset as usize + bytes.len();
        bytes.copy_from_slice(&chip.before[range.clone()]);
        if bytes == &chip.after[range.clone()] {
            return Ok(());
        }
        let coin = chip.source.bits();
        for (byte, at) in bytes.iter_mut().zip(range) {
            let few = |bits: u64| (bits & bits >> 8 & bits >> 16 & bits >> 24 & bits >> 32) as u8;
            let changed = match chip.doubt[at] {
                Doubt::Even | Doubt::AllBits => chip.source.bits() as u8,
                Doubt::HardlyChanged => few(chip.source.bits()),
                Doubt::NearlyChanged => !few(chip.source.bits()),
                Doubt::Whole => 0u8.wrapping_sub(coin as u8 & 1),
            };
            *byte = *byte & !changed | chip.after[at] & changed;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.borrow().before.len()
    }
}

impl NorFlash for Cells {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        for page in (from as usize..to as usize).step_by(PAGE) {
            let done = self.0.borrow_mut().change(page, PAGE, |_, _| 0xFF);
            if !done {
                std::future::pending().await
            }
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        let unit = self.0.borrow().unit;
        let (mut at, mut bytes) = (offset as usize, bytes);
        while !bytes.is_empty() {
            let (part, rest) = bytes.split_at(bytes.len().min(unit - at % unit));
            let program = |index: usize, byte| byte & part[index];
            let done = self.0.borrow_mut().change(at, part.len(), program);
            if !done {
                std::future::pending().await
            }
            (at, bytes) = (at + part.len(), rest);
        }
        Ok(())
    }
}

/// A save, a factory reset and the key's gesture succeed on flash that works, and are found after
/// a restart.
fn assert_writable(flash: &Cells, model: &Model, source: &mut Random, context: &str) {
    let flash = flash.copy(source.bits());
    let mut model = model.clone();
    let save = Change::Save(KEYS[source.below(KEYS.len())], source.bytes(300));
    for change in [save, Change::FactoryReset, Change::LostKey] {
        assert_eq!(change.make(&mut flash.start()), Some(Ok(())), "{context}");
        model = change.apply(&model);
        for _ in 0..2 {
            assert!(
                flash.held() == Some(Ok(model.clone())),
                "{context}: {change:?}"
            );
        }
    }
}

#[derive(Debug, Default)]
struct CellCounts {
    changes: u64,
    cuts: u64,
    cuts_in_repairs: u64,
    kept_old: u64,
    took_new: u64,
}

/// Makes changes until power has been lost `cuts` times, `times` times at every unit and erase of each
/// change, or at one in `stride` of them; now and then again while the flash is repaired, or twice. What
/// follows begins with the flash of one of the cuts, or with that of none.
fn lose_power_unstably(
    [unit, pages]: [usize; 2],
    seed: u64,
    cuts: u64,
    times: u64,
    stride: usize,
) -> CellCounts {
    let mut source = Random::new(seed);
    let mut counts = CellCounts::default();
    let mut flash = Cells::new(unit, &vec![0xFF; pages * PAGE], seed);
    let mut model = Model::new();
    while counts.cuts < cuts {
        let change = Change::random(&mut source);
        let next = change.apply(&model);
        let whole = flash.copy(source.bits());
        let outcome = change.make(&mut whole.start());
        assert_eq!(outcome, Some(Ok(())), "{change:?}");
        assert!(whole.held() == Some(Ok(next.clone())), "{change:?}");
        let steps = whole.0.borrow().changed;
        let chosen = source.below(1 + 2 * (steps * times) as usize) as u64;
        let mut following = (whole, next.clone());
        let first = source.below(stride) as u64;
        for cut in (first..steps * times).step_by(stride) {
            let context = format!(
                "{} cut at {} of {steps}, {counts:?}",
                change.name(),
                cut / times
            );
            let torn = flash.copy(source.bits());
            torn.lose_power_after(Some(cut / times));
            // The order of steps can differ where cells read differently: nothing is lost then.
            let is_done = change.make(&mut torn.start()) == Some(Ok(()));
            counts.cuts += 1;
            for _ in 0..[0, 0, 0, 1, 2][source.below(5)] {
                torn.lose_power_after(Some(source.below(8) as u64));
                let _ = torn.held();
                counts.cuts_in_repairs += 1;
            }
            torn.lose_power_after(None);
            let found = torn
                .held()
                .expect("power")
                .unwrap_or_else(|_| panic!("{context}"));
            if found == next {
                counts.took_new += 1;
            } else {
                let wrong = |key: &Key| found.get(&number(*key)) != model.get(&number(*key));
                let wrong: Vec<Key> = KEYS.into_iter().filter(wrong).collect();
                assert!(wrong.is_empty() && !is_done, "{context}: {wrong:?}");

                counts.kept_old += 1;
            }
            // What a start has found stays.
            for _ in 0..2 {
                assert!(torn.held() == Some(Ok(found.clone())), "{context}");
            }
            if cut % 3 == 0 {
                assert_writable(&torn, &found, &mut source, &context);
            }
            assert_eq!(change.make(&mut torn.start()), Some(Ok(())), "{context}");
            assert!(torn.held() == Some(Ok(next.clone())), "{context}, again");
            if cut / stride as u64 == chosen / stride as u64 {
                following = (torn, next.clone());
            }
        }
        (flash, model) = following;
        counts.changes += 1;
    }
    counts
}

#[test]
fn unstable_cells_leave_the_old_records_or_the_new_for_good() {
    let (cuts, stride, seed) = Lane::current().choose([(40, 61, 1), (400, 17, 1), (50_000, 1, 2)]);
    for (unit, name) in [(4, "words of 4 bytes"), (256, "pages of 256 bytes")] {
        let (times, stride) = match unit {
            4 => (1, stride),
            _ => (Lane::current().choose([1, 1, 8]), 1),
        };
        let mut all = CellCounts::default();
        for pages in [2, 4] {
            let counts = lose_power_unstably([unit, pages], seed, cuts, times, stride);
            println!("{unit} bytes, {pages} pages: {counts:?}");
            all.cuts += counts.cuts;
            all.kept_old += counts.kept_old;
            all.took_new += counts.took_new;
        }
        let claim = format!("cuts that leave unstable {name}: neither old nor new");
        figure(&claim, format!("0 of {}", all.cuts), "none", true);
        assert!(all.kept_old > 10 && all.took_new > 2, "{all:?}");
    }
}

/// Flash as earlier firmware left it after so many random changes, and what it then held:
/// `tests/vectors/flash`. That firmware marked pages in their first and last word.
fn left_by_earlier_firmware(pages: usize, changes: usize) -> (Vec<u8>, Model) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("vectors/flash");
    let file = folder.join(format!("{pages}-{changes}.bin"));
    let mut image = std::fs::read(file).expect("the stored image");
    if pages == 2 {
        // It began at the second page.
        image.drain(..PAGE);
    }
    image.truncate(pages * PAGE);
    let mut source = Random::new(77);
    let model = (0..changes).fold(Model::new(), |model, _| {
        Change::random(&mut source).apply(&model)
    });
    (image, model)
}

/// Flash as this firmware leaves it.
fn left_by_this_firmware(pages: usize, changes: usize) -> (Vec<u8>, Model) {
    let flash = Cells::new(4, &vec![0xFF; pages * PAGE], 1);
    let mut source = Random::new(changes as u64);
    let model = (0..changes).fold(Model::new(), |model, _| {
        let change = Change::random(&mut source);
        assert_eq!(change.make(&mut flash.start()), Some(Ok(())));
        change.apply(&model)
    });
    let image = flash.0.borrow().before.clone();
    (image, model)
}

/// Images of both, with their pages.
fn images() -> Vec<(usize, Vec<u8>, Model)> {
    let earlier = [(4, 9), (4, 90), (2, 37)].map(|(pages, changes)| {
        let (image, model) = left_by_earlier_firmware(pages, changes);
        (pages, image, model)
    });
    let own = [(4, 9), (4, 60), (2, 23)].map(|(pages, changes)| {
        let (image, model) = left_by_this_firmware(pages, changes);
        (pages, image, model)
    });
    earlier.into_iter().chain(own).collect()
}

/// Where the marks of pages are.
fn marks(pages: usize) -> impl Iterator<Item = usize> {
    (0..pages).flat_map(|page| [page * PAGE, (page + 1) * PAGE - 4])
}

#[test]
fn page_marks_of_any_kind_lose_nothing_and_leave_flash_that_can_be_written() {
    let mut source = Random::new(8);
    let mut tried = 0;
    for (pages, image, model) in images() {
        for combination in 0..1 << (2 * pages) {
            let mut image = image.clone();
            for (index, at) in marks(pages).enumerate() {
                image[at..at + 4].fill([0xFF, 0][combination >> index & 1]);
            }
            let flash = Cells::new(4, &image, source.bits());
            let context = format!("{pages} pages, marks {combination:#b}");
            assert!(flash.held() == Some(Ok(model.clone())), "{context}");
            if combination % 7 == 0 {
                assert_writable(&flash, &model, &mut source, &context);
            }
            tried += 1;
        }
        for at in marks(pages) {
            for mark in [
                [0xFF; 4],
                [0; 4],
                [0xF0, 0xFF, 0xFF, 0xFF],
                [0xFF, 0xFF, 0xFF, 0x3C],
            ] {
                let mut image = image.clone();
                image[at..at + 4].copy_from_slice(&mark);
                let flash = Cells::new(4, &image, source.bits());
                let context = format!("{pages} pages, mark {mark:?} at {at:#x}");
                assert!(flash.held() == Some(Ok(model.clone())), "{context}");
                assert_writable(&flash, &model, &mut source, &context);
                tried += 1;
            }
        }
    }
    println!("{tried} combinations of marks");
}

#[test]
fn whatever_is_left_of_a_store_can_be_written() {
    let mut source = Random::new(9);
    for (pages, image, _) in images() {
        for damage in 0..40 * pages {
            let mut image = image.clone();
            let page = damage % pages * PAGE;
            for byte in &mut image[page..page + PAGE] {
                match damage / pages {
                    0 => *byte = 0xFF,
                    1 => *byte = 0,
                    2 => *byte = source.bits() as u8,
                    _ if source.below(400) == 0 => *byte = source.bits() as u8,
                    _ => {}
                }
            }
            let flash = Cells::new(4, &image, source.bits());
            let context = format!("{pages} pages, damage {damage}");
            let settings = source.bytes(30);
            let change = Change::Save(Key::Settings, settings.clone());
            assert_eq!(change.make(&mut flash.start()), Some(Ok(())), "{context}");
            let found = load(&mut flash.start(), Key::Settings);
            assert_eq!(found, Ok(Some(settings)), "{context}");
            for reset in [Change::FactoryReset, Change::LostKey] {
                assert_eq!(reset.make(&mut flash.start()), Some(Ok(())), "{context}");
                for key in KEYS.into_iter().filter(|&key| reset.is_removed()(key)) {
                    assert_eq!(load(&mut flash.start(), key), Ok(None), "{context}");
                }
            }
        }
    }
}
