//! The store in a flash that loses power at every byte, wears out, fills up and rots.

mod cells;

use std::collections::BTreeMap;

use embassy_futures::block_on;
use wimu_node::{FlashLayout, FlashStore, Key, MAX_RECORD, PageFlash, Store, StoreFault};
use wimu_sim::storage::Storage;
use wimu_testkit::{Lane, figure, trials};
use wimu_tests::Random;

/// What a store is to hold.
type Model = BTreeMap<u8, Vec<u8>>;

const KEYS: [Key; 7] = [
    Key::Parameters { range_g: 2 },
    Key::Parameters { range_g: 4 },
    Key::Parameters { range_g: 8 },
    Key::Parameters { range_g: 16 },
    Key::Settings,
    Key::LineRate,
    Key::DeviceKey,
];

fn number(key: Key) -> u8 {
    key.number().expect("one of ours")
}

fn load(store: &mut impl Store, key: Key) -> Result<Option<Vec<u8>>, StoreFault> {
    let mut record = [0; MAX_RECORD];
    let length = store.load(key, &mut record)?;
    Ok(length.map(|length| record[..length].to_vec()))
}

/// The store of a board that has just started, in the fewest pages or in the usual four.
fn start(storage: &Storage, pages: usize) -> FlashStore<Storage> {
    const TWO: FlashLayout<Storage> = FlashLayout::new(0x1000..0x3000);
    match pages {
        2 => FlashStore::new(storage.clone(), TWO, 0),
        _ => storage.store(),
    }
}

/// What a store that has just started finds.
fn held(storage: &Storage, pages: usize) -> Result<Model, StoreFault> {
    let mut store = start(storage, pages);
    let mut model = Model::new();
    for key in KEYS {
        if let Some(record) = load(&mut store, key)? {
            model.insert(number(key), record);
        }
    }
    Ok(model)
}

/// A change of what is stored.
#[derive(Clone, Debug)]
enum Change {
    Save(Key, Vec<u8>),
    FactoryReset,
    LostKey,
}

impl Change {
    /// As hosts do: parameters and settings mostly, keys and starts often, resets now and then.
    fn random(source: &mut Random) -> Self {
        let (key, length) = match source.below(20) {
            0..8 => (KEYS[source.below(4)], 100 + source.below(157)),
            8..12 => (Key::Settings, 30),
            12..15 => (Key::LineRate, 5),
            15..18 => (Key::DeviceKey, 33),
            18 => return Self::FactoryReset,
            _ => return Self::LostKey,
        };
        Self::Save(key, source.bytes(length))
    }

    fn name(&self) -> String {
        match self {
            Self::Save(key, record) => format!("save {} bytes under {key:?}", record.len()),
            _ => format!("{self:?}"),
        }
    }

    fn is_removed(&self) -> fn(Key) -> bool {
        match self {
            Self::Save(..) => |_| false,
            Self::FactoryReset => |key| matches!(key, Key::Parameters { .. } | Key::Settings),
            Self::LostKey => |key| matches!(key, Key::DeviceKey | Key::Settings),
        }
    }

    fn make(&self, store: &mut impl Store) -> Result<(), StoreFault> {
        match self {
            Self::Save(key, record) => block_on(store.save(*key, record)),
            _ => block_on(store.remove(self.is_removed())),
        }
    }

    fn apply(&self, model: &Model) -> Model {
        let mut model = model.clone();
        if let Self::Save(key, record) = self {
            model.insert(number(*key), record.clone());
        }
        let removed = self.is_removed();
        model.retain(|&number, _| !Key::from_number(number).is_some_and(removed));
        model
    }
}

#[derive(Debug, Default)]
struct Counts {
    changes: u64,
    cuts: u64,
    cuts_in_repairs: u64,
    kept_old: u64,
    took_new: u64,
    erases: u64,
}

/// Makes `changes` changes, and each again and again with power lost after every `stride` bytes
/// of it; then once more, with power lost again while the flash is repaired.
fn lose_power(pages: usize, seed: u64, changes: u64, stride: u64) -> Counts {
    let mut source = Random::new(seed);
    let mut counts = Counts::default();
    let storage = Storage::in_memory();
    let mut model = Model::new();
    for _ in 0..changes {
        let before = storage.image();
        let change = Change::random(&mut source);
        let next = change.apply(&model);
        let changed_before = storage.bytes_changed();
        assert_eq!(change.make(&mut start(&storage, pages)), Ok(()), "{change:?}");
        assert_eq!(held(&storage, pages), Ok(next.clone()), "{change:?}");
        let bytes = storage.bytes_changed() - changed_before;
        let first = source.below(stride as usize) as u64;
        for cut in (first..bytes).step_by(stride as usize) {
            let torn = Storage::from_image(&before);
            torn.lose_power_after(Some(cut));
            assert!(change.make(&mut start(&torn, pages)).is_err(), "{change:?}");
            counts.cuts += 1;
            if cut % 7 == 0 {
                // Power is lost again while what is torn is being repaired, or written anew.
                torn.lose_power_after(Some(source.below(1 + bytes as usize) as u64));
                let _ = change.make(&mut start(&torn, pages));
                counts.cuts_in_repairs += 1;
            }
            torn.lose_power_after(None);
            let found = held(&torn, pages)
                .unwrap_or_else(|_| panic!("{} cut after {cut} {counts:?}", change.name()));
            if found == model {
                counts.kept_old += 1;
            } else {
                assert!(found == next, "{change:?} cut after {cut}");
                counts.took_new += 1;
            }
            // Life goes on: the same change again, and it stands.
            assert_eq!(change.make(&mut start(&torn, pages)), Ok(()));
            assert!(held(&torn, pages) == Ok(next.clone()), "{change:?} cut after {cut}, again");
        }
        model = next;
        counts.changes += 1;
    }
    counts.erases = storage.erases().iter().map(|&erases| u64::from(erases)).sum();
    let worn = storage.erases().into_iter().filter(|_| pages == 4 || counts.erases == 0);
    let spread = worn.clone().max().zip(worn.min());
    assert!(spread.is_none_or(|(most, least)| most - least <= 1), "{:?}", storage.erases());
    counts
}

#[test]
fn power_lost_at_any_byte_leaves_the_old_records_or_the_new() {
    let ([two, four], stride, seed) =
        Lane::current().choose([([20, 30], 61, 1), ([30, 50], 61, 1), ([240, 240], 1, 2)]);
    let mut all = Counts::default();
    for (pages, changes) in [(2, two), (4, four)] {
        // Asserts that each cut leaves the old records or the new, and a store that can be written.
        let counts = lose_power(pages, seed, changes, stride);
        println!("{pages} pages: {counts:?}");
        all.cuts += counts.cuts;
        all.cuts_in_repairs += counts.cuts_in_repairs;
        all.kept_old += counts.kept_old;
        all.took_new += counts.took_new;
        all.erases += counts.erases;
    }
    figure(
        "power lost after any byte of a change: neither old nor new records",
        format!("0 of {}", all.cuts),
        "none",
        true,
    );
    figure(
        "power lost again during the repair",
        format!("0 of {}", all.cuts_in_repairs),
        "none",
        true,
    );
    let least = Lane::current().choose([200, 500, 60_000]);
    assert!(all.cuts >= least && all.erases > 3, "{all:?}");
    assert!(all.kept_old > 20 && all.took_new > 20, "{all:?}");
}

/// A store that holds a record under every key, but for `spare` bytes less in each.
fn filled(storage: &Storage, pages: usize, spare: usize) -> Model {
    let mut store = start(storage, pages);
    let mut source = Random::new(7);
    for key in KEYS {
        let record = source.bytes(MAX_RECORD - spare);
        assert_eq!(block_on(store.save(key, &record)), Ok(()), "{key:?}");
    }
    held(storage, pages).expect("readable")
}

#[test]
fn a_full_store_refuses_what_does_not_fit_and_keeps_what_it_holds() {
    let storage = Storage::in_memory();
    let mut store = start(&storage, 2);
    let mut source = Random::new(3);
    let mut model = Model::new();
    let mut refused = 0;
    // More ranges than any sensor has.
    for round in 0..4 {
        for range_g in 1..20 {
            let key = Key::Parameters { range_g };
            let record = source.bytes(MAX_RECORD - round * 60);
            match block_on(store.save(key, &record)) {
                Ok(()) => drop(model.insert(number(key), record)),
                Err(StoreFault) => refused += 1,
            }
            for (&number, record) in &model {
                let key = Key::from_number(number).expect("one of ours");
                assert_eq!(load(&mut store, key).as_ref(), Ok(&Some(record.clone())));
            }
        }
    }
    assert!(refused > 10 && model.len() >= 2, "{refused} {}", model.len());
    // Refusing wears nothing.
    let erases = storage.erases();
    let large = source.bytes(MAX_RECORD);
    for _ in 0..50 {
        let outcome = block_on(store.save(Key::Parameters { range_g: 100 }, &large));
        assert_eq!(outcome, Err(StoreFault));
    }
    assert_eq!(storage.erases(), erases);
    // There is room again when something has been removed.
    let removed = block_on(store.remove(|key| matches!(key, Key::Parameters { .. })));
    assert_eq!(removed, Ok(()));
    assert_eq!(filled(&storage, 2, 0).len(), KEYS.len());
}

#[test]
fn what_a_node_keeps_fits_at_its_longest_and_can_be_changed_for_ever() {
    let storage = Storage::in_memory();
    let mut store = start(&storage, 4);
    let mut source = Random::new(11);
    let mut model = Model::new();
    for round in 0..200 {
        let key = KEYS[round % KEYS.len()];
        let length = match key {
            Key::Parameters { .. } => MAX_RECORD,
            _ => 64,
        };
        let change = Change::Save(key, source.bytes(length));
        assert_eq!(change.make(&mut store), Ok(()), "{round}");
        model = change.apply(&model);
        assert_eq!(held(&storage, 4), Ok(model.clone()));
    }
}

/// The boards' geometry: four pages of 4 KiB, words of 4 bytes.
#[test]
fn a_change_erases_half_the_pages_and_64_starts_do() {
    let storage = Storage::in_memory();
    filled(&storage, 4, 0);
    let mut store = start(&storage, 4);
    let mut source = Random::new(13);
    let before = storage.erases();
    for push in 0..100 {
        let record = source.bytes(MAX_RECORD);
        assert_eq!(block_on(store.save(KEYS[push % 4], &record)), Ok(()));
    }
    let after_pushes = storage.erases();
    assert_eq!(after_pushes, before.map(|erases| erases + 50));
    for _ in 0..6400 {
        block_on(store.count_start()).expect("counted");
    }
    let most = storage.erases().iter().zip(after_pushes).map(|(now, then)| now - then).max();
    figure("erases of a page for 6400 starts", most.unwrap_or(0), "at most 51", most <= Some(51));
    assert!(most <= Some(51), "{most:?}");
}

/// Also those whose power is lost while they are counted.
#[test]
fn no_two_starts_have_the_same_number() {
    let mut source = Random::new(17);
    let flash = cells::Cells::new(4, &vec![0xFF; 2 * cells::PAGE], 17);
    let mut latest = 0;
    let mut interrupted = 0;
    for start in 0..Lane::current().choose([600, 600, 20_000]) {
        let cut = (source.below(3) == 0).then(|| source.below(6) as u64);
        flash.lose_power_after(cut);
        let number = block_on(flash.start().count_start());
        flash.lose_power_after(None);
        match number {
            Ok(number) => {
                assert!(number > latest, "start {start}: {number} after {latest}");
                latest = number;
            }
            Err(StoreFault) => {
                assert!(cut.is_some(), "start {start}");
                interrupted += 1;
            }
        }
        if source.below(40) == 0 {
            let change = Change::random(&mut source);
            assert_eq!(change.make(&mut flash.start()), Ok(()));
        }
    }
    assert!(interrupted > 20, "{interrupted}");
}

#[test]
fn worn_out_flash_refuses_writes_and_keeps_what_it_holds() {
    let storage = Storage::in_memory();
    let model = filled(&storage, 4, 100);
    // Bytes that are stuck all over a page but for its marks, or over all pages, found when something is
    // written or moved there.
    for (page, pages) in [(0, 1), (1, 1), (2, 1), (3, 1), (0, 4)] {
        let worn = Storage::from_image(&storage.image());
        for at in (page * 4096 + 40..(page + pages) * 4096 - 4).step_by(97) {
            worn.stick(at, 0);
        }
        let mut store = worn.store();
        let mut source = Random::new(page as u64);
        let mut model = model.clone();
        let mut refused = 0;
        for _ in 0..Lane::current().choose([20, 20, 60]) {
            let change = Change::random(&mut source);
            match change.make(&mut store) {
                Ok(()) => model = change.apply(&model),
                Err(StoreFault) => refused += 1,
            }
            assert_eq!(held(&worn, 4), Ok(model.clone()), "page {page}, {change:?}");
        }
        assert!(refused > 0 || pages == 1, "page {page}");
    }
}

/// One byte of the headers and marks of either half stays erased.
#[test]
fn a_change_that_is_refused_does_not_happen() {
    let storage = Storage::in_memory();
    let model = filled(&storage, 4, 100);
    let mut refused = 0;
    for at in (0..900).flat_map(|at| [at, 2 * 4096 + at]) {
        let worn = Storage::from_image(&storage.image());
        worn.stick(at, 0xFF);
        let change = Change::Save(Key::Settings, vec![5; 30]);
        let outcome = change.make(&mut worn.store());
        refused += u32::from(outcome.is_err());
        let expected = if outcome.is_ok() { change.apply(&model) } else { model.clone() };
        assert_eq!(held(&worn, 4), Ok(expected), "byte {at}: {outcome:?}");
    }
    assert!(refused > 100, "{refused}");
}

#[test]
fn a_record_that_is_damaged_after_it_was_saved_is_an_error_and_no_older_one() {
    let storage = Storage::in_memory();
    let mut store = storage.store();
    for generation in 0..3 {
        for key in KEYS {
            let record = [generation * 16 + number(key); 200];
            assert_eq!(block_on(store.save(key, &record)), Ok(()));
        }
    }
    let model = held(&storage, 4).expect("readable");
    for key in KEYS {
        let damaged = Storage::from_image(&storage.image());
        damaged.corrupt(key);
        let mut store = damaged.store();
        for other in KEYS {
            let found = load(&mut store, other);
            if other == key {
                assert_eq!(found, Err(StoreFault), "{key:?}");
            } else {
                assert_eq!(found, Ok(model.get(&number(other)).cloned()), "{key:?}");
            }
        }
        // Written again, it is whole again.
        assert_eq!(block_on(store.save(key, b"new")), Ok(()));
        assert_eq!(load(&mut damaged.store(), key), Ok(Some(b"new".to_vec())));
    }
}

#[test]
fn what_stands_behind_a_hole_in_a_page_never_returns() {
    let settings = |generation: u8| vec![generation; 100];
    let (mut worth, mut holes) = (0, 0);
    for hole in (0..0x400).step_by(Lane::current().choose([16, 8, 4])) {
        holes += 1;
        let storage = Storage::in_memory();
        let mut store = start(&storage, 2);
        for generation in 1..4 {
            assert_eq!(block_on(store.save(Key::Settings, &settings(generation))), Ok(()));
        }
        let mut image = storage.image();
        image[0x1000 + hole..][..40].fill(0xFF);
        let storage = Storage::from_image(&image);
        let mut store = start(&storage, 2);
        let saved = block_on(store.save(Key::Settings, &settings(9))) == Ok(());
        worth += u32::from(saved);
        // Enough to turn the pages.
        for round in 0..30 {
            let _ = block_on(store.save(Key::LineRate, &[round; 200]));
            let found = load(&mut start(&storage, 2), Key::Settings);
            if saved {
                assert_eq!(found, Ok(Some(settings(9))), "hole at {hole:#x}, round {round}");
            }
        }
    }
    assert!(5 * worth > 4 * holes, "{worth} of {holes} could be saved");
}

#[test]
fn any_single_byte_damaged_loses_at_most_one_record_and_never_returns_another() {
    let storage = Storage::in_memory();
    let mut store = storage.store();
    let mut source = Random::new(5);
    let mut model = Model::new();
    let mut older: Vec<Model> = Vec::new();
    for _ in 0..12 {
        older.push(model.clone());
        let change = Change::random(&mut source);
        assert_eq!(change.make(&mut store), Ok(()));
        model = change.apply(&model);
    }
    let image = storage.image();
    let used = image.iter().rposition(|&byte| byte != 0xFF).unwrap_or(0).min(8192);
    let mut reported = 0;
    for at in 0..used {
        let mut image = image.clone();
        image[at] ^= 1 << source.below(8);
        let mut store = Storage::from_image(&image).store();
        let mut lost = 0;
        for key in KEYS {
            match load(&mut store, key) {
                Err(StoreFault) => lost += 1,
                Ok(found) => {
                    assert_eq!(found.as_ref(), model.get(&number(key)), "{key:?}, byte {at}");
                }
            }
        }
        assert!(lost <= 1, "byte {at}: {lost}");
        reported += lost;
    }
    figure(
        "one damaged byte of a store: more than one record lost, or a wrong one",
        format!("0 of {used}"),
        "none",
        true,
    );
    assert!(reported > 100);
}

#[test]
fn noise_is_reported_and_can_be_written_again() {
    for seed in 0..trials(3000) as u64 {
        let mut source = Random::new(seed);
        let length = 1 + source.below(4 * 4096);
        let noise = source.bytes(length);
        let storage = Storage::from_image(&noise);
        let mut store = storage.store();
        for key in KEYS {
            // Short noise looks like a first record that power loss interrupted.
            let found = load(&mut store, key);
            assert!(found == Err(StoreFault) || (found == Ok(None) && length <= 8192));
        }
        let change = Change::Save(Key::LineRate, source.bytes(5));
        assert_eq!(change.make(&mut store), Ok(()), "{seed}");
        let model = change.apply(&Model::new());
        for key in KEYS {
            // What was lost stays an error until it is written.
            let found = load(&mut storage.store(), key);
            let expected = model.get(&number(key)).cloned();
            assert!(found == Ok(expected) || found == Err(StoreFault) && key != Key::LineRate);
        }
    }
}

#[test]
fn whatever_is_left_of_a_store_can_be_written() {
    use cells::{Cells, PAGE};
    let mut source = Random::new(9);
    for (pages, changes) in [(4, 9), (4, 60), (2, 23)] {
        let flash = Cells::new(4, &vec![0xFF; pages * PAGE], 1);
        for _ in 0..changes {
            let change = Change::random(&mut source);
            assert_eq!(change.make(&mut flash.start()), Ok(()));
        }
        let image = flash.0.borrow().before.clone();
        for damage in 0..Lane::current().choose([10, 20, 40]) * pages {
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
            assert_eq!(change.make(&mut flash.start()), Ok(()), "{context}");
            let found = load(&mut flash.start(), Key::Settings);
            assert_eq!(found, Ok(Some(settings)), "{context}");
            for reset in [Change::FactoryReset, Change::LostKey] {
                assert_eq!(reset.make(&mut flash.start()), Ok(()), "{context}");
                for key in KEYS.into_iter().filter(|&key| reset.is_removed()(key)) {
                    assert_ne!(
                        load(&mut flash.start(), key).ok().flatten().map(drop),
                        Some(()),
                        "{context}"
                    );
                }
            }
        }
    }
}
