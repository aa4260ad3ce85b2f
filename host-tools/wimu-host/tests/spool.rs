//! Messages that wait for a broker, in the folder that another gateway or a killed one may have used.

use std::fs;
use std::io::{BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use wimu_host::Result;
use wimu_host::fleet::mqtt::{Mqtt, MqttConfig};

/// Port without a broker.
const NOWHERE: u16 = 1;
const MB: u64 = 1 << 20;

fn start(folder: &Path, port: u16, limit: u64) -> Result<Mqtt> {
    let broker = format!("mqtt://127.0.0.1:{port}").parse().unwrap();
    let config = MqttConfig {
        spool: Some((folder.to_owned(), limit)),
        ..MqttConfig::new(&broker, vec!["none".to_owned()])
    };
    Mqtt::start(config, |_| {})
}

/// Messages of 10 kB that begin with their numbers.
fn publish(mqtt: &Mqtt, numbers: std::ops::Range<u32>) {
    for number in numbers {
        let mut payload = vec![0; 10_000];
        payload[..4].copy_from_slice(&number.to_le_bytes());
        mqtt.publish("wimu/f/b/up".to_owned(), payload);
    }
}

/// A broker that acknowledges messages and gives their numbers.
fn broker() -> (u16, Receiver<u32>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let (sender, numbers) = channel();
    std::thread::spawn(move || {
        while let Ok((stream, _)) = listener.accept() {
            serve(stream, &sender);
        }
    });
    (port, numbers)
}

/// Until the connection ends. MQTT 3.1.1, section 3.
fn serve(mut stream: TcpStream, numbers: &Sender<u32>) -> Option<()> {
    let mut reader = BufReader::new(stream.try_clone().ok()?);
    loop {
        let mut byte = [0];
        reader.read_exact(&mut byte).ok()?;
        let kind = byte[0];
        let (mut length, mut shift) = (0, 0);
        while shift == 0 || byte[0] >= 0x80 {
            reader.read_exact(&mut byte).ok()?;
            length |= usize::from(byte[0] & 0x7F) << shift;
            shift += 7;
        }
        let mut body = vec![0; length];
        reader.read_exact(&mut body).ok()?;
        match kind >> 4 {
            1 => stream.write_all(&[0x20, 2, 0, 0]).ok()?,
            3 => {
                let id = 2 + usize::from(u16::from_be_bytes([body[0], body[1]]));
                stream.write_all(&[0x40, 2, body[id], body[id + 1]]).ok()?;
                let number = body[id + 2..id + 6].try_into().ok()?;
                numbers.send(u32::from_le_bytes(number)).ok()?;
            }
            8 => stream.write_all(&[0x90, 3, body[0], body[1], 0]).ok()?,
            12 => stream.write_all(&[0xD0, 0]).ok()?,
            _ => {}
        }
    }
}

/// A connection to a broker that has been there for so long that it gets what waits, with the next message.
fn settled(folder: &Path, limit: u64) -> (Mqtt, Receiver<u32>) {
    let (port, numbers) = broker();
    let mqtt = start(folder, port, limit).unwrap();
    mqtt.wait_connected().unwrap();
    std::thread::sleep(Duration::from_millis(1600));
    (mqtt, numbers)
}

/// The numbers of the next messages, `count` of them.
fn received(numbers: &Receiver<u32>, count: u64) -> Vec<u32> {
    let next = |_| numbers.recv_timeout(Duration::from_secs(20)).expect("a message");
    (0..count).map(next).collect()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = paths.filter(|path| path.is_file()).collect();
    files.sort();
    files
}

#[test]
fn order_is_kept_over_a_restart_and_foreign_files_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let foreign = ["+5.spool", "5.spool", "ffffffffffffffff.spool", "x.spool", ".spool"];
    for name in foreign {
        fs::write(folder.join(name), "mine").unwrap();
    }
    // Names that the spool would take next.
    for number in [1_u64 << 32, (1 << 32) - 1] {
        fs::create_dir(folder.join(format!("{number:016x}.spool"))).unwrap();
    }
    let mqtt = start(folder, NOWHERE, 64 * MB).unwrap();
    publish(&mqtt, 0..300);
    assert!(mqtt.figures().spool_bytes > 1_000_000);
    assert!(start(folder, NOWHERE, 64 * MB).is_err(), "another program uses the folder");
    drop(mqtt);
    let (mqtt, numbers) = settled(folder, 64 * MB);
    assert_eq!(mqtt.figures().waiting, 300);
    publish(&mqtt, 300..301);
    assert_eq!(received(&numbers, 301), Vec::from_iter(0..=300));
    drop(mqtt);
    let mut left: Vec<_> = foreign.map(|name| folder.join(name)).into();
    left.push(folder.join("lock"));
    left.sort();
    assert_eq!(files(folder), left);
    for name in foreign {
        assert_eq!(fs::read(folder.join(name)).unwrap(), b"mine", "{name}");
    }
}

#[test]
fn beyond_the_limit_the_oldest_are_dropped_and_of_a_damaged_file_what_follows_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mqtt = start(folder, NOWHERE, 2 * MB).unwrap();
    publish(&mqtt, 0..500);
    let figures = mqtt.figures();
    assert_eq!(figures.dropped + figures.waiting, 500);
    assert!(figures.waiting < 330, "{figures:?}");
    drop(mqtt);
    // In the middle of the last file but one.
    let files = files(folder);
    let spools: Vec<_> = files.iter().filter(|path| path.extension().is_some()).collect();
    let damaged = spools[spools.len() - 2];
    let mut bytes = fs::read(damaged).unwrap();
    bytes[500_000] ^= 1;
    fs::write(damaged, bytes).unwrap();
    let (mqtt, numbers) = settled(folder, 64 * MB);
    let left = mqtt.figures().waiting;
    publish(&mqtt, 500..501);
    assert!(left < figures.waiting && left > figures.waiting - 110, "{left} {figures:?}");
    let kept = received(&numbers, left + 1);
    assert!(kept.is_sorted() && kept.last() == Some(&500), "{kept:?}");
}

#[cfg(unix)]
#[test]
fn a_lock_that_is_a_link_is_refused_and_its_target_kept() {
    let outside = tempfile::tempdir().unwrap();
    let target = outside.path().join("target");
    fs::write(&target, "mine").unwrap();
    let folder = outside.path().join("spool");
    fs::create_dir(&folder).unwrap();
    for target in [target.as_path(), &outside.path().join("absent")] {
        std::os::unix::fs::symlink(target, folder.join("lock")).unwrap();
        let error = start(&folder, NOWHERE, 64 * MB).err().expect("a link");
        assert!(error.to_string().contains("lock"), "{error}");
        fs::remove_file(folder.join("lock")).unwrap();
    }
    assert_eq!(fs::read(target).unwrap(), b"mine");
    assert!(!outside.path().join("absent").exists());
}
