//! The recorded plays of a session, one after the other. A separate thread reads ahead.
//!
//! Bound: three pages of rows in memory, and the items of one sequence.

use super::plan::Recorded;
use crate::cli::export::warn_incomplete;
use anyhow::Result;
use meissner_api::{RecordedPlay, SessionPlays};
use meissner_client::{Client, ClientError, DISK_TIMEOUT, escape};
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

/// See the module.
pub(super) struct Rows {
    pages: Receiver<Result<SessionPlays, ClientError>>,
    rows: VecDeque<RecordedPlay>,
    /// Whether the missing parts of the record were reported.
    told: bool,
}

impl Rows {
    /// Starts reading with this client.
    pub(super) fn read(mut client: Client, id: &str) -> Result<Self> {
        let path = format!("/v1/sessions/{}/plays?from=", escape(id));
        let (sender, pages) = sync_channel(1);
        let work = move || {
            let mut from = 0;
            loop {
                let page: Result<SessionPlays, _> = client.get_within(DISK_TIMEOUT, &format!("{path}{from}"));
                let more = page.as_ref().is_ok_and(|page| page.more && !page.plays.is_empty());
                from += page.as_ref().map_or(0, |page| page.plays.len());
                // An error means that the replay has ended.
                if sender.send(page).is_err() || !more {
                    return;
                }
            }
        };
        thread::Builder::new().name("record".into()).spawn(work)?;
        Ok(Self { pages, rows: VecDeque::new(), told: false })
    }

    fn row(&mut self) -> Result<Option<RecordedPlay>> {
        while self.rows.is_empty() {
            let Ok(page) = self.pages.recv() else { return Ok(None) };
            let page = page?;
            if !std::mem::replace(&mut self.told, true) {
                warn_incomplete(&page);
            }
            self.rows = page.plays.into();
        }
        Ok(self.rows.pop_front())
    }
}

impl Iterator for Rows {
    type Item = Result<Recorded>;

    fn next(&mut self) -> Option<Self::Item> {
        let play = match self.row() {
            Ok(row) => row?,
            Err(error) => return Some(Err(error)),
        };
        let mut items = Vec::new();
        for _ in 0..play.items {
            match self.row() {
                Ok(Some(item)) => items.push(item),
                Ok(None) => break,
                Err(error) => return Some(Err(error)),
            }
        }
        Some(Ok(Recorded { play, items }))
    }
}
