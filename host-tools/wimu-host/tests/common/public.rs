//! The public recordings beside the repository.

use std::path::{Path, PathBuf};

/// A file of `../shared/data`; `None` where it is absent.
pub fn file(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    if !path.exists() {
        println!("skipped: {name} of the public recordings, ../shared/data, is absent");
        return None;
    }
    Some(path)
}
