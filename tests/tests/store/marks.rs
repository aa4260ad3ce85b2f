//! Flash whose pages carry any marks, left by earlier firmware and by this one.

use super::cells::{CellCounts, Cells, PAGE, UNITS, assert_writable, lose_power_once};
use super::*;

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
    let model =
        (0..changes).fold(Model::new(), |model, _| Change::random(&mut source).apply(&model));
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

/// An image with blank marks, and zeros where a bit of `combination` is set.
fn marked(image: &[u8], pages: usize, combination: usize) -> Vec<u8> {
    let mut image = image.to_vec();
    for (index, at) in marks(pages).enumerate() {
        image[at..at + 4].fill([0xFF, 0][combination >> index & 1]);
    }
    image
}

#[test]
fn page_marks_of_any_kind_lose_nothing_and_leave_flash_that_can_be_written() {
    let mut source = Random::new(8);
    let mut tried = 0;
    for (pages, image, model) in images() {
        for combination in 0..1 << (2 * pages) {
            let image = marked(&image, pages, combination);
            let flash = Cells::new(4, &image, source.bits());
            let context = format!("{pages} pages, marks {combination:#b}");
            assert!(flash.held() == Some(Ok(model.clone())), "{context}");
            if combination % 7 == 0 {
                assert_writable(&flash, &model, &mut source, &context);
            }
            tried += 1;
        }
        for at in marks(pages) {
            for mark in [[0xFF; 4], [0; 4], [0xF0, 0xFF, 0xFF, 0xFF], [0xFF, 0xFF, 0xFF, 0x3C]] {
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

/// Every combination of whole and blank page marks, on flash of earlier firmware and of this one, with both units: the
/// first start after an update may lose power too.
#[test]
fn power_lost_with_any_page_marks_leaves_the_old_records_or_the_new() {
    let (every, cuts) = Lane::current().choose([(41, 1), (13, 2), (1, 96)]);
    let mut all = CellCounts::default();
    let mut combinations = 0;
    for (unit, _) in UNITS {
        for (index, (pages, image, model)) in images().into_iter().enumerate() {
            let mut source = Random::new(21 + index as u64);
            for combination in (0..1 << (2 * pages)).step_by(every) {
                let image = marked(&image, pages, combination);
                let flash = Cells::new(unit, &image, source.bits());
                let change = Change::random(&mut source);
                let next = change.apply(&model);
                let steps = flash.copy(source.bits()).steps_of(&change, &next);
                for cut in 0..cuts {
                    let at = match steps < cuts {
                        true => cut % steps.max(1),
                        false => source.below(steps as usize) as u64,
                    };
                    let context = format!(
                        "image {index}, {unit} bytes, marks {combination:#b}, {} cut at {at} of {steps}",
                        change.name()
                    );
                    let counted = (&mut source, &mut all);
                    lose_power_once(&flash, &change, [&model, &next], at, counted, &context);
                }
                combinations += 1;
            }
        }
    }
    println!("{combinations} combinations: {all:?}");
    figure(
        "power lost with any page marks and cells: neither old nor new",
        format!("0 of {} ({combinations} combinations)", all.cuts),
        "none",
        Lane::current() != Lane::Campaign || all.cuts >= 200_000,
    );
    assert!(all.kept_old > 5 && all.took_new > 2, "{all:?}");
    all.assert_all_doubts(Lane::current().choose([0, 5, 1000]));
}
