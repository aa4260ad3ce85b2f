//! The folder of keys: what it keeps, and whom it trusts.

use std::fs;

use wimu_host::Code;
use wimu_host::keys::{KeyFolder, generate};
use wimu_link::auth::DeviceKey;

#[test]
fn a_key_is_kept_for_its_owner_only_until_it_is_forgotten() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("wimu/keys");
    let keys = KeyFolder::at(&path);
    assert_eq!(keys.candidates(7), Ok(vec![]));
    let (first, second) = (generate().expect("random"), generate().expect("random"));
    assert!(first != second);
    keys.prepare(7, &first).expect("written");
    assert_eq!(keys.candidates(7), Ok(vec![first]));
    keys.confirm(7).expect("renamed");
    keys.prepare(7, &second).expect("written");
    assert_eq!(keys.candidates(7), Ok(vec![first, second]));
    keys.withdraw(7);
    assert_eq!(keys.candidates(7), Ok(vec![first]));
    assert_eq!(keys.candidates(8), Ok(vec![]));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |path: &std::path::Path| fs::metadata(path).expect("there").permissions().mode();
        assert_eq!(mode(&keys.file(7)) & 0o777, 0o600);
        assert_eq!(mode(&path) & 0o777, 0o700);
    }
    keys.forget(7).expect("removed");
    assert_eq!(keys.candidates(7), Ok(vec![]));
    keys.forget(7).expect("nothing to remove");
}

#[test]
fn a_key_that_the_device_has_outlives_whatever_comes_between() {
    let folder = tempfile::tempdir().expect("a folder");
    let keys = KeyFolder::at(folder.path());
    let [first, second, third] = [1, 2, 3].map(|byte| DeviceKey::new([byte; 32]));
    // Killed between the device's answer and its being noted; then a rotation that never
    // reaches the device.
    keys.prepare(7, &first).expect("written");
    assert_eq!(keys.settle(7, second.id()), Ok(None));
    assert_eq!(keys.settle(7, first.id()), Ok(Some(first)));
    keys.prepare(7, &second).expect("written");
    assert_eq!(keys.settle(7, first.id()), Ok(Some(first)));
    // An answer in the device's name, but not by it.
    keys.confirm(7).expect("renamed");
    assert_eq!(keys.settle(7, first.id()), Ok(Some(first)));
    keys.prepare(7, &third).expect("written");
    assert_eq!(keys.candidates(7), Ok(vec![second, third, first]));
    // A disk that was full, by a version that wrote in place.
    fs::write(folder.path().join("0000000000000007.new.key"), "").expect("written");
    assert_eq!(keys.candidates(7), Ok(vec![second, first]));
    keys.drop_replaced(7);
    assert_eq!(keys.candidates(7), Ok(vec![second]));
}

#[cfg(unix)]
#[test]
fn a_folder_that_others_can_change_is_not_trusted() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().expect("a folder");
    let keys = KeyFolder::at(folder.path());
    let open = |mode| fs::set_permissions(folder.path(), fs::Permissions::from_mode(mode));
    open(0o777).expect("changed");
    let error = keys.candidates(7).expect_err("others can write there");
    assert!(error.to_string().contains("chmod 700"), "{error}");
    let key = DeviceKey::new([1; 32]);
    assert!(keys.prepare(7, &key).is_err());
    open(0o700).expect("changed");
    keys.prepare(7, &key).expect("written");
}

#[cfg(unix)]
#[test]
fn nor_is_one_that_others_can_exchange() {
    use std::os::unix::fs::{PermissionsExt, symlink};

    let folder = tempfile::tempdir().expect("a folder");
    let parent = folder.path().join("parent");
    let keys = KeyFolder::at(&parent.join("wimu").join("keys"));
    let key = DeviceKey::new([1; 32]);
    keys.prepare(7, &key).expect("written");
    let link = folder.path().join("link");
    symlink(parent.join("wimu"), &link).expect("a link");
    let open = |mode| {
        fs::set_permissions(&parent, fs::Permissions::from_mode(mode)).expect("changed");
    };
    for keys in [keys, KeyFolder::at(&link.join("keys"))] {
        for (mode, trusted) in [(0o777, false), (0o1777, true), (0o775, true), (0o702, false)] {
            open(mode);
            let read = keys.candidates(7);
            assert_eq!(read.is_ok(), trusted, "{mode:o}: {read:?}");
            assert_eq!(keys.prepare(7, &key).is_ok(), trusted, "{mode:o}");
        }
    }
    open(0o700);
}

#[test]
fn a_file_that_holds_no_key_says_what_is_wrong_and_never_what_it_holds() {
    let folder = tempfile::tempdir().expect("a folder");
    let keys = KeyFolder::at(folder.path());
    keys.prepare(7, &DeviceKey::new([0xC5; 32])).expect("written");
    keys.confirm(7).expect("renamed");
    let whole = fs::read_to_string(keys.file(7)).expect("there");
    for text in [
        "",
        "c5",
        &whole[1..],
        &format!("c5{whole}"),
        &whole.replace('5', "x"),
        &whole.replace("c5", "+5"),
        "µ",
    ] {
        fs::write(keys.file(7), text).expect("written");
        let error = keys.candidates(7).expect_err("no key");
        assert_eq!(error.code, Code::FileUnreadable);
        assert!(error.to_string().contains("64 hexadecimal digits"), "{error}");
        assert!(!error.to_string().contains("c5c5"), "{error}");
    }
    fs::write(keys.file(7), &whole).expect("written");
    assert_eq!(keys.candidates(7).map(|keys| keys.len()), Ok(1));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let open = fs::Permissions::from_mode(0o644);
        fs::set_permissions(keys.file(7), open).expect("changed");
        let error = keys.candidates(7).expect_err("readable by others");
        assert!(error.to_string().contains("others can read"), "{error}");
    }
}
