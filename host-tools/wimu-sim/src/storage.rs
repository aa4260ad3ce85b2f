//! The simulated board's non-volatile memory.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use wimu_node::{Key, Store, StoreFault};

/// Records that survive the board's restarts, and the program's if they are kept in a file.
/// Clones are the same memory.
#[derive(Clone, Debug, Default)]
pub struct Storage {
    records: Rc<RefCell<BTreeMap<u8, Vec<u8>>>>,
    file: Option<PathBuf>,
    /// Whether writes fail, as those of a worn-out flash do.
    worn_out: Rc<RefCell<bool>>,
}

impl Storage {
    /// Memory that ends with the program.
    pub fn in_memory() -> Self {
        Self::default()
    }

    /// Memory kept in the file at `path`, which is made when something is stored.
    ///
    /// A file is a series of records: key, length (16 bits, lowest first), bytes. It is replaced
    /// as a whole, so that a program that is killed leaves the old one or the new one.
    ///
    /// # Errors
    /// When the file is there but cannot be read. One that is damaged holds what can be read of it;
    /// the node finds out.
    pub fn in_file(path: &Path) -> io::Result<Self> {
        let bytes = match fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error),
        };
        let mut records = BTreeMap::new();
        let mut rest = bytes.as_slice();
        while let [key, low, high, after @ ..] = rest {
            let length = usize::from(u16::from_le_bytes([*low, *high])).min(after.len());
            let (record, after) = after.split_at(length);
            records.insert(*key, record.to_vec());
            rest = after;
        }
        Ok(Self {
            records: Rc::new(RefCell::new(records)),
            file: Some(path.to_path_buf()),
            ..Self::default()
        })
    }

    /// Makes every write fail from now on, or succeed again.
    pub fn set_worn_out(&self, worn_out: bool) {
        *self.worn_out.borrow_mut() = worn_out;
    }

    /// Damages the stored record of `key`, if there is one.
    pub fn corrupt(&self, key: Key) {
        if let Some(record) = self.records.borrow_mut().get_mut(&number(key))
            && let Some(byte) = record.get_mut(3)
        {
            *byte ^= 0x55;
        }
    }

    fn change(&self, change: impl FnOnce(&mut BTreeMap<u8, Vec<u8>>)) -> Result<(), StoreFault> {
        if *self.worn_out.borrow() {
            return Err(StoreFault);
        }
        let mut records = self.records.borrow().clone();
        change(&mut records);
        if let Some(path) = &self.file {
            let mut bytes = Vec::new();
            for (key, record) in &records {
                let length = u16::try_from(record.len()).map_err(|_| StoreFault)?;
                bytes.push(*key);
                bytes.extend(length.to_le_bytes());
                bytes.extend(record);
            }
            let new = path.with_extension("new");
            fs::write(&new, bytes)
                .and_then(|()| fs::rename(&new, path))
                .map_err(|_| StoreFault)?;
        }
        *self.records.borrow_mut() = records;
        Ok(())
    }
}

impl Store for Storage {
    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let records = self.records.borrow();
        let Some(record) = records.get(&number(key)) else {
            return Ok(None);
        };
        buffer
            .get_mut(..record.len())
            .ok_or(StoreFault)?
            .copy_from_slice(record);
        Ok(Some(record.len()))
    }

    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        self.change(|records| {
            records.insert(number(key), record.to_vec());
        })
    }

    async fn remove(&mut self, key: Key) -> Result<(), StoreFault> {
        self.change(|records| {
            records.remove(&number(key));
        })
    }
}

fn number(key: Key) -> u8 {
    match key {
        Key::Parameters => 1,
        Key::Settings => 2,
        Key::BootCount => 3,
    }
}
