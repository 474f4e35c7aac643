//! Where the steps of a play come from: a compiled pattern or sequence, or motions that change while it runs.

use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::{LiveStrokes, Step, Strokes, StrokesError};

/// The steps of a play.
#[derive(Clone, Debug)]
pub enum Source {
    /// Compiled from a pattern or a sequence.
    Compiled(Box<Strokes>),
    /// Of a live play, which has one item and no end.
    Live(Box<LiveStrokes>),
}

impl From<Strokes> for Source {
    fn from(strokes: Strokes) -> Self {
        Self::Compiled(Box::new(strokes))
    }
}

impl Source {
    /// The array that they are for.
    pub fn array(&self) -> Array {
        match self {
            Self::Compiled(strokes) => strokes.array(),
            Self::Live(strokes) => strokes.array(),
        }
    }

    /// Begins, or begins again, at `onset`.
    pub fn begin(&mut self, onset: Tick) {
        match self {
            Self::Compiled(strokes) => strokes.begin(onset),
            Self::Live(strokes) => strokes.begin(onset),
        }
    }

    fn compiled(&self) -> Option<&Strokes> {
        match self {
            Self::Compiled(strokes) => Some(strokes),
            Self::Live(_) => None,
        }
    }

    /// When each item begins.
    pub fn onsets(&self) -> impl Iterator<Item = Tick> {
        let (compiled, live) = match self {
            Self::Compiled(strokes) => (Some(strokes.onsets()), None),
            Self::Live(strokes) => (None, Some(strokes.onset())),
        };
        compiled.into_iter().flatten().chain(live)
    }

    /// Ticks from the onset to the end; `None`: without end.
    pub fn end(&self) -> Option<u64> {
        self.compiled()?.end()
    }

    /// A lower bound on the first tick of the next step of `motor`.
    pub(crate) fn next_up(&self, motor: u8) -> Option<Tick> {
        match self {
            Self::Compiled(strokes) => strokes.next_up(motor),
            Self::Live(strokes) => strokes.next_up(motor),
        }
    }

    /// When the next item begins, if only items follow.
    pub(crate) fn next_onset(&self) -> Option<Tick> {
        self.compiled()?.next_onset()
    }

    /// Goes on to the next item.
    pub(crate) fn next_item(&mut self) {
        if let Self::Compiled(strokes) = self {
            strokes.next_item();
        }
    }

    /// The number of the present item.
    pub(crate) fn item(&self) -> usize {
        self.compiled().map_or(0, Strokes::item)
    }

    /// Whether this item drives a motor.
    pub(crate) fn item_drives(&self, item: usize, motor: u8) -> bool {
        self.compiled().is_none_or(|strokes| strokes.item_drives(item, motor))
    }

    /// Whether all steps of this item were returned.
    pub(crate) fn item_is_over(&self, item: usize) -> bool {
        self.compiled().is_some_and(|strokes| strokes.item_is_over(item))
    }

    /// When this item ends, if it plays nothing.
    pub(crate) fn blank_until(&self, item: usize) -> Option<Tick> {
        self.compiled()?.blank_until(item)
    }

    /// Whether this motor may be driven. A live play may drive any motor.
    pub fn drives(&self, motor: u8) -> bool {
        self.compiled().is_none_or(|strokes| strokes.drives(motor))
    }

    /// The motors that they may drive, in order.
    pub fn motors(&self) -> impl Iterator<Item = u8> {
        self.array().numbers().filter(|&motor| self.drives(motor))
    }

    /// The drives that may change, if these are of a live play.
    pub(crate) fn live(&mut self) -> Option<&mut LiveStrokes> {
        match self {
            Self::Compiled(_) => None,
            Self::Live(strokes) => Some(strokes),
        }
    }
}

impl Iterator for Source {
    type Item = Result<Step, StrokesError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::Compiled(strokes) => strokes.next(),
            Self::Live(strokes) => strokes.next(),
        }
    }
}
