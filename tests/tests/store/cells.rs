//! Flash whose cells read differently each time after power was lost while they were changed.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};

use super::*;

pub const PAGE: usize = 4096;
/// Flash of up to four pages. Each bit of a unit whose programming was interrupted, and of a page whose
/// erase was, reads as before or as after, until it is programmed to 0 or its page is erased.
#[derive(Clone)]
pub struct Cells(pub Rc<RefCell<Chip>>);

#[derive(Clone)]
pub struct Chip {
    /// What each byte was before a change, and what it is after; both are the same if it is certain.
    pub before: Vec<u8>,
    after: Vec<u8>,
    doubt: Vec<Doubt>,
    /// What is programmed at once, bytes: a word, as on an nRF52, or a page of an RP2040's flash.
    unit: usize,
    source: Random,
    /// Units and pages that can be changed before power is lost.
    left: Option<u64>,
    has_power: bool,
    changed: u64,
    /// That of the change which was interrupted last.
    latest_doubt: Option<Doubt>,
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

const DOUBTS: [Doubt; 5] =
    [Doubt::Even, Doubt::HardlyChanged, Doubt::NearlyChanged, Doubt::Whole, Doubt::AllBits];

/// What is programmed at once, bytes.
pub const UNITS: [(usize, &str); 2] = [(4, "words of 4 bytes"), (256, "pages of 256 bytes")];

impl Cells {
    pub fn new(unit: usize, image: &[u8], seed: u64) -> Self {
        Self(Rc::new(RefCell::new(Chip {
            before: image.to_vec(),
            after: image.to_vec(),
            doubt: vec![Doubt::Even; image.len()],
            unit,
            source: Random::new(seed),
            left: None,
            has_power: true,
            changed: 0,
            latest_doubt: None,
        })))
    }

    /// Another of the same, whose doubtful cells read in another way.
    pub fn copy(&self, seed: u64) -> Self {
        let mut chip = self.0.borrow().clone();
        chip.source = Random::new(seed);
        chip.changed = 0;
        chip.latest_doubt = None;
        Self(Rc::new(RefCell::new(chip)))
    }

    pub fn lose_power_after(&self, changes: Option<u64>) {
        let mut chip = self.0.borrow_mut();
        chip.left = changes;
        chip.has_power = true;
    }

    /// Makes a change without losing power; returns how many units and pages it changed.
    pub fn steps_of(&self, change: &Change, next: &Model) -> u64 {
        assert_eq!(change.make(&mut self.start()), Ok(()), "{change:?}");
        assert!(self.held() == Ok(next.clone()), "{change:?}");
        self.0.borrow().changed
    }

    pub fn start(&self) -> FlashStore<Self> {
        const TWO: FlashLayout<Cells> = FlashLayout::new(0..2 * PAGE as u32);
        const FOUR: FlashLayout<Cells> = FlashLayout::new(0..4 * PAGE as u32);
        let layout = match self.0.borrow().before.len() / PAGE {
            2 => TWO,
            _ => FOUR,
        };
        FlashStore::new(self.clone(), layout, 0)
    }

    /// What a store finds that has just started.
    pub fn held(&self) -> Result<Model, StoreFault> {
        let mut store = self.start();
        let mut model = Model::new();
        let mut record = [0; MAX_RECORD];
        for key in KEYS {
            if let Some(length) = store.load(key, &mut record)? {
                model.insert(number(key), record[..length].to_vec());
            }
        }
        Ok(model)
    }
}

impl Chip {
    /// Changes bytes; false when power is lost meanwhile.
    fn change(&mut self, at: usize, length: usize, change: impl Fn(usize, u8) -> u8) -> bool {
        if !self.has_power {
            return false;
        }
        let interrupted = self.left == Some(0);
        self.has_power = !interrupted;
        let doubt = DOUBTS[self.source.below(DOUBTS.len())];
        if interrupted {
            self.latest_doubt = Some(doubt);
        }
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
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Cells {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let chip = &mut *self.0.borrow_mut();
        if !chip.has_power {
            return Err(NorFlashErrorKind::Other);
        }
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

impl PageFlash for Cells {}

impl NorFlash for Cells {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        for page in (from as usize..to as usize).step_by(PAGE) {
            let done = self.0.borrow_mut().change(page, PAGE, |_, _| 0xFF);
            if !done {
                return Err(NorFlashErrorKind::Other);
            }
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let unit = self.0.borrow().unit;
        let (mut at, mut bytes) = (offset as usize, bytes);
        while !bytes.is_empty() {
            let (part, rest) = bytes.split_at(bytes.len().min(unit - at % unit));
            let program = |index: usize, byte| byte & part[index];
            let done = self.0.borrow_mut().change(at, part.len(), program);
            if !done {
                return Err(NorFlashErrorKind::Other);
            }
            (at, bytes) = (at + part.len(), rest);
        }
        Ok(())
    }
}

/// A save, a factory reset and the key's gesture succeed on flash that works, and are found after
/// a restart.
pub fn assert_writable(flash: &Cells, model: &Model, source: &mut Random, context: &str) {
    let flash = flash.copy(source.bits());
    let mut model = model.clone();
    let save = Change::Save(KEYS[source.below(KEYS.len())], source.bytes(200));
    for change in [save, Change::FactoryReset, Change::LostKey] {
        assert_eq!(change.make(&mut flash.start()), Ok(()), "{context}");
        model = change.apply(&model);
        for _ in 0..2 {
            assert!(flash.held() == Ok(model.clone()), "{context}: {change:?}");
        }
    }
}

#[derive(Debug, Default)]
pub struct CellCounts {
    changes: u64,
    pub cuts: u64,
    cuts_in_repairs: u64,
    pub kept_old: u64,
    pub took_new: u64,
    /// Cuts that interrupted a change, by [`Doubt`].
    by_doubt: [u64; DOUBTS.len()],
}

impl CellCounts {
    fn add(&mut self, other: &Self) {
        self.changes += other.changes;
        self.cuts += other.cuts;
        self.cuts_in_repairs += other.cuts_in_repairs;
        self.kept_old += other.kept_old;
        self.took_new += other.took_new;
        for (sum, cuts) in self.by_doubt.iter_mut().zip(other.by_doubt) {
            *sum += cuts;
        }
    }

    pub fn assert_all_doubts(&self, least: u64) {
        assert!(self.by_doubt.iter().all(|&cuts| cuts >= least), "{self:?}");
    }
}

/// Loses power at a unit or erase of a change, now and then again while the flash is repaired, or twice; returns the
/// flash after the change was made again.
pub fn lose_power_once(
    flash: &Cells,
    change: &Change,
    [model, next]: [&Model; 2],
    at: u64,
    (source, counts): (&mut Random, &mut CellCounts),
    context: &str,
) -> Cells {
    let torn = flash.copy(source.bits());
    torn.lose_power_after(Some(at));
    // The order of steps can differ where cells read differently: nothing is lost then.
    let is_done = change.make(&mut torn.start()) == Ok(());
    counts.cuts += 1;
    if let Some(doubt) = torn.0.borrow().latest_doubt {
        counts.by_doubt[doubt as usize] += 1;
    }
    for _ in 0..[0, 0, 0, 1, 2][source.below(5)] {
        torn.lose_power_after(Some(source.below(8) as u64));
        let _ = torn.held();
        counts.cuts_in_repairs += 1;
    }
    torn.lose_power_after(None);
    let found = torn.held().unwrap_or_else(|_| panic!("{context}"));
    if found == *next {
        counts.took_new += 1;
    } else {
        let wrong = |key: &Key| found.get(&number(*key)) != model.get(&number(*key));
        let wrong: Vec<Key> = KEYS.into_iter().filter(wrong).collect();
        assert!(wrong.is_empty() && !is_done, "{context}: {wrong:?}");
        counts.kept_old += 1;
    }
    // What a start has found stays.
    for _ in 0..2 {
        assert!(torn.held() == Ok(found.clone()), "{context}");
    }
    if counts.cuts.is_multiple_of(3) {
        assert_writable(&torn, &found, source, context);
    }
    assert_eq!(change.make(&mut torn.start()), Ok(()), "{context}");
    assert!(torn.held() == Ok(next.clone()), "{context}, again");
    torn
}

/// Makes changes until power has been lost `cuts` times, `times` times at every unit and erase of each
/// change, or at one in `stride` of them. What follows begins with the flash of one of the cuts, or with that of none.
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
        let steps = whole.steps_of(&change, &next);
        let chosen = source.below(1 + 2 * (steps * times) as usize) as u64;
        let mut following = whole;
        let first = source.below(stride) as u64;
        for cut in (first..steps * times).step_by(stride) {
            let at = cut / times;
            let context = format!("{} cut at {at} of {steps}, {counts:?}", change.name());
            let counted = (&mut source, &mut counts);
            let torn = lose_power_once(&flash, &change, [&model, &next], at, counted, &context);
            if cut / stride as u64 == chosen / stride as u64 {
                following = torn;
            }
        }
        (flash, model) = (following, next);
        counts.changes += 1;
    }
    counts
}

#[test]
fn unstable_cells_leave_the_old_records_or_the_new_for_good() {
    let (cuts, stride, seed) = Lane::current().choose([(40, 61, 1), (200, 31, 1), (50_000, 1, 2)]);
    for (unit, name) in UNITS {
        let (times, stride) = match unit {
            4 => (1, stride),
            _ => (Lane::current().choose([1, 1, 8]), 1),
        };
        let mut all = CellCounts::default();
        for pages in [2, 4] {
            let counts = lose_power_unstably([unit, pages], seed, cuts, times, stride);
            println!("{unit} bytes, {pages} pages: {counts:?}");
            all.add(&counts);
        }
        let claim = format!("cuts that leave unstable {name}: neither old nor new");
        figure(&claim, format!("0 of {}", all.cuts), "none", true);
        assert!(all.kept_old > 10 && all.took_new > 2, "{all:?}");
        all.assert_all_doubts(Lane::current().choose([0, 3, 1000]));
    }
}
