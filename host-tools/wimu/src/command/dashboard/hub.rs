//! What pages are sent: the latest value of each topic, and a stream of frames of which slow pages miss the oldest.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use serde::Serialize;
use serde_json::json;
use tokio::sync::Notify;
use wimu_host::Result;
use wimu_host::serve::lock;

/// Frames that wait for a page: two seconds of one board.
const MOST_FRAMES: usize = 64;
/// Answers that wait for a page.
const MOST_ANSWERS: usize = 64;

/// A message as it is sent.
pub type Text = Arc<str>;

/// The topics and the pages.
#[derive(Default)]
pub struct Hub {
    state: Mutex<State>,
    /// Pages so far: a board sends its history when it grows.
    joined: AtomicUsize,
}

#[derive(Default)]
struct State {
    topics: BTreeMap<String, Text>,
    pages: Vec<Arc<Page>>,
}

/// The messages that wait for a page.
#[derive(Default)]
pub struct Page {
    queue: Mutex<Queue>,
    more: Notify,
    /// Whether it may see anything yet.
    admitted: AtomicBool,
}

#[derive(Default)]
struct Queue {
    /// Topics whose latest value it has not got.
    topics: BTreeSet<String>,
    frames: VecDeque<Text>,
    answers: VecDeque<Text>,
    /// Frames that were dropped, and how many of them it was told of.
    dropped: [u64; 2],
}

impl Hub {
    /// Changes a topic.
    pub fn publish(&self, topic: &str, value: &impl Serialize) {
        let text = json!({"topic": topic, "value": value}).to_string();
        let mut state = lock(&self.state);
        if state.topics.get(topic).is_some_and(|known| **known == *text) {
            return;
        }
        state.topics.insert(topic.to_owned(), text.into());
        for page in &state.pages {
            page.change(|queue| {
                queue.topics.insert(topic.to_owned());
            });
        }
    }

    /// Removes the topics of a board or a file that is gone.
    pub fn withdraw(&self, prefix: &str) {
        let mut state = lock(&self.state);
        let gone = |topic: &String| topic.starts_with(prefix);
        state.topics.retain(|topic, _| !gone(topic));
        let text: Text = json!({ "gone": prefix }).to_string().into();
        for page in &state.pages {
            page.change(|queue| {
                queue.topics.retain(|topic| !gone(topic));
                queue.answer(text.clone());
            });
        }
    }

    /// Sends a frame to all pages.
    pub fn stream(&self, frame: &impl Serialize) {
        let state = lock(&self.state);
        if state.pages.is_empty() {
            return;
        }
        let Ok(text) = serde_json::to_string(frame) else {
            return;
        };
        let text: Text = text.into();
        for page in &state.pages {
            page.change(|queue| {
                queue.frames.push_back(text.clone());
                if queue.frames.len() > MOST_FRAMES {
                    queue.frames.pop_front();
                    queue.dropped[0] += 1;
                }
            });
        }
    }

    /// Admits a page: it gets the value of all topics.
    pub fn join(&self, page: &Arc<Page>) {
        if page.admitted.swap(true, Ordering::Relaxed) {
            return;
        }
        let mut state = lock(&self.state);
        page.change(|queue| queue.topics.extend(state.topics.keys().cloned()));
        state.pages.push(page.clone());
        self.joined.fetch_add(1, Ordering::Relaxed);
    }

    /// Forgets a page.
    pub fn leave(&self, page: &Arc<Page>) {
        lock(&self.state).pages.retain(|one| !Arc::ptr_eq(one, page));
    }

    /// How many pages have joined so far.
    pub fn joined(&self) -> usize {
        self.joined.load(Ordering::Relaxed)
    }

    /// What waits for a page, once there is something.
    pub async fn next(&self, page: &Page) -> Vec<Text> {
        loop {
            let texts = self.take(page);
            if !texts.is_empty() {
                return texts;
            }
            page.more.notified().await;
        }
    }

    fn take(&self, page: &Page) -> Vec<Text> {
        let mut queue = lock(&page.queue);
        let names = std::mem::take(&mut queue.topics);
        let mut out: Vec<Text> = queue.answers.drain(..).collect();
        if queue.dropped[0] != queue.dropped[1] {
            queue.dropped[1] = queue.dropped[0];
            out.push(json!({ "dropped": queue.dropped[0] }).to_string().into());
        }
        let frames = std::mem::take(&mut queue.frames);
        // The hub locks a page while it holds its own lock.
        drop(queue);
        if !names.is_empty() {
            let state = lock(&self.state);
            out.extend(names.iter().filter_map(|name| state.topics.get(name).cloned()));
        }
        out.extend(frames);
        out
    }
}

impl Page {
    fn change(&self, change: impl FnOnce(&mut Queue)) {
        change(&mut lock(&self.queue));
        self.more.notify_one();
    }

    /// Whether it has joined.
    pub fn is_admitted(&self) -> bool {
        self.admitted.load(Ordering::Relaxed)
    }
}

impl Queue {
    fn answer(&mut self, text: Text) {
        if self.answers.len() < MOST_ANSWERS {
            self.answers.push_back(text);
        }
    }
}

/// Where the answer to a message of a page goes.
#[derive(Clone)]
pub struct Asker {
    pub page: Arc<Page>,
    /// Number of the message.
    pub id: u64,
}

impl Asker {
    /// Answers with a value, or an error.
    pub fn answer(&self, outcome: Result<impl Serialize>) {
        let text = match outcome {
            Ok(value) => json!({"answer": self.id, "value": value}),
            Err(error) => json!({"answer": self.id, "error": error.to_string()}),
        };
        let text: Text = text.to_string().into();
        self.page.change(|queue| queue.answer(text));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(hub: &Hub, page: &Page) -> Vec<String> {
        let texts = hub.take(page);
        texts.iter().map(|text| text.to_string()).collect()
    }

    #[test]
    fn a_page_gets_the_latest_of_each_topic_and_nothing_before_it_is_admitted() {
        let (hub, page) = (Hub::default(), Arc::new(Page::default()));
        hub.publish("a", &1);
        hub.publish("a", &2);
        assert!(taken(&hub, &page).is_empty());
        hub.join(&page);
        assert_eq!(taken(&hub, &page), [r#"{"topic":"a","value":2}"#]);
        hub.publish("a", &2);
        assert!(taken(&hub, &page).is_empty(), "it has not changed");
        hub.leave(&page);
        hub.publish("a", &3);
        assert!(taken(&hub, &page).is_empty());
    }

    #[test]
    fn a_page_that_does_not_read_loses_the_oldest_frames_and_learns_how_many() {
        let (hub, page) = (Hub::default(), Arc::new(Page::default()));
        hub.join(&page);
        for k in 0..MOST_FRAMES + 3 {
            hub.stream(&k);
        }
        let texts = taken(&hub, &page);
        assert_eq!(texts[..2], [r#"{"dropped":3}"#, "3"]);
        assert_eq!(texts.len(), MOST_FRAMES + 1);
    }
}
