//! Objects: a surface, and how it touches the finger.
//!
//! An [`Object`] is cut into [`Grains`] for its contact. Only what lies under the finger at some time of its touch is cut: the pad, an
//! ellipse of 18 × 24 mm, and a margin.
//!
//! The modules: `surface` is the height over a place, `part` the piece of it that counts in a box, `shapes` the shapes that a file may name,
//! each with its keys, `file` reads object files, `source` their parts, `image` height maps, `error` has limits and what can be wrong.

mod error;
mod file;
mod image;
mod part;
mod shapes;
mod source;
mod surface;

pub use error::{MAX_FILE_BYTES, MAX_PIXELS, MAX_POINTS, MAX_SIDE_MM, ObjectError, Problem};
pub use file::Drawn;
pub use source::{Open, no_files};
pub use surface::{HeightMap, Surface};

use crate::grains::Grains;
use crate::shape::Shape;
use crate::touch::{Frame, Touch};
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM};
use part::Part;

/// How far beyond the pad an object counts, mm.
pub const MARGIN_MM: f64 = 1.0;
/// The finest and the coarsest pitch of grains, mm.
pub const PITCHES_MM: std::ops::RangeInclusive<f64> = 0.05..=1.0;

/// The coarsest pitch that is chosen, mm. Afferents of a class lie about 1 mm apart.
const COARSEST_MM: f64 = 0.4;
/// The finest pitch of an object whose poses are not known before, mm: its imprint reaches far, and pins are 3 mm apart.
const LIVE_MM: f64 = 0.1;
/// Grains are chosen so coarse that there are at most this many.
const ENOUGH: f64 = 12_000.0;
/// Width of a line that gives none, mm.
pub const LINE_MM: f64 = 0.8;
/// Diameter of a dot that gives none, mm.
pub const DOT_MM: f64 = 2.0;

/// An object that touches a finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Object {
    name: String,
    surface: Surface,
    touch: Touch,
}

impl Object {
    /// An object with this surface.
    pub fn new(name: &str, surface: Surface, touch: Touch) -> Self {
        Self { name: name.to_owned(), surface, touch }
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The surface.
    pub const fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The lines that draw it, by their points on the skin in mm, where the touch begins, in the order of the file: a line itself, the
    /// middle line of a bar, the outline of a polygon, a line of one point for a dot. None for height maps and textures.
    pub fn lines_mm(&self) -> Option<Vec<Vec<[f64; 2]>>> {
        let pose = self.touch.pose(0.0);
        let frame = Frame::of(&pose);
        let on_skin = |lines: Vec<Vec<[f64; 2]>>| -> Vec<Vec<[f64; 2]>> {
            lines.into_iter().map(|line| line.into_iter().map(|at| frame.outward(at)).collect()).collect()
        };
        match &self.surface {
            // A grating has lines where the pad is.
            Surface::Near { shape, .. } => {
                Some(shape.moved([pose.x_mm, pose.y_mm], pose.angle_deg).outline())
            }
            Surface::Lines { lines, .. } => Some(on_skin(lines.clone())),
            Surface::Polygons(polygons) => {
                Some(on_skin(polygons.iter().map(|corners| surface::drawn(corners)).collect()))
            }
            Surface::Map(_) => None,
        }
    }

    /// How it touches.
    pub const fn touch(&self) -> &Touch {
        &self.touch
    }

    /// The pitch of grains that suits the object, mm: a quarter of the finest width or an eighth of a
    /// dot, at most 0.4, and coarser for large objects.
    pub fn pitch_mm(&self) -> f64 {
        let pitch_mm = self.surface.fitting_pitch_mm(&(*PITCHES_MM.start()..=COARSEST_MM));
        enough(pitch_mm, self.box_mm(&self.under_finger()))
    }

    /// The grains of the part within `reach_mm` of the frame's origin, along each axis, that touch the skin at a depth of `most_mm`.
    /// Their pitch is that of [`Self::pitch_mm`], but at least 0.1 mm. There may be none.
    pub fn grains_within(&self, reach_mm: f64, most_mm: f64) -> Grains {
        let [low, high] = self.surface.bounds();
        let part = [low.map(|low| low.max(-reach_mm)), high.map(|high| high.min(reach_mm))];
        let pitch_mm = enough(self.surface.fitting_pitch_mm(&(LIVE_MM..=COARSEST_MM)), part);
        self.cut(pitch_mm, part, most_mm, |_| true)
    }

    /// Whether the object lies within this distance of its frame's origin along each axis.
    pub fn is_within(&self, reach_mm: f64) -> bool {
        self.surface.bounds().iter().flatten().all(|mm| mm.abs() <= reach_mm)
    }

    /// The grains of a pitch, within [`PITCHES_MM`], that touch the skin at some time. There may be none.
    pub fn grains(&self, pitch_mm: f64) -> Grains {
        let frames = self.under_finger();
        let most_mm = self.touch.most_depth_mm();
        let (a, b) = (PAD_WIDTH_MM / 2.0 + MARGIN_MM, PAD_LENGTH_MM / 2.0 + MARGIN_MM);
        let is_under = |at: [f64; 2]| {
            frames.iter().any(|frame| {
                let [x, y] = frame.outward(at);
                x * x / (a * a) + y * y / (b * b) <= 1.0
            })
        };
        self.cut(pitch_mm, self.box_mm(&frames), most_mm, is_under)
    }

    /// Grains of what lies in a box and touches the skin at a depth of `most_mm`.
    fn cut(
        &self,
        pitch_mm: f64,
        part: [[f64; 2]; 2],
        most_mm: f64,
        kept: impl Fn([f64; 2]) -> bool,
    ) -> Grains {
        let whole = Part::of(&self.surface);
        let mut row = (f64::NAN, whole.clone());
        let surface_in = |[low, high]: [[f64; 2]; 2]| {
            if row.0.to_bits() != low[1].to_bits() {
                row = (low[1], whole.within([[f64::NEG_INFINITY, low[1]], [f64::INFINITY, high[1]]]));
            }
            let cell = row.1.within([low, high]);
            move |at| cell.height_mm(at).filter(|height_mm| height_mm + most_mm > 0.0)
        };
        let [low, high] = self.surface.bounds();
        let middle = [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0);
        // A grating has no middle.
        let middle = middle.map(|middle| if middle.is_finite() { middle } else { 0.0 });
        Grains::cut(pitch_mm, part, middle, kept, surface_in)
    }

    /// The object's frame whenever it touches the finger.
    fn under_finger(&self) -> Vec<Frame> {
        self.touch.in_contact(1.0).iter().map(Frame::of).collect()
    }

    /// The lowest and the highest x and y of what lies under the finger.
    fn box_mm(&self, frames: &[Frame]) -> [[f64; 2]; 2] {
        let [mut low, mut high] = self.surface.bounds();
        let reach = PAD_LENGTH_MM / 2.0 + MARGIN_MM;
        let middles = || frames.iter().map(|frame| frame.inward([0.0; 2]));
        for axis in 0..2 {
            let places = || middles().map(|middle| middle[axis]);
            low[axis] = low[axis].max(places().fold(f64::INFINITY, f64::min) - reach);
            high[axis] = high[axis].min(places().fold(f64::NEG_INFINITY, f64::max) + reach);
        }
        [low, high]
    }
}

/// A pitch that cuts a box into few enough cells.
fn enough(pitch_mm: f64, [low, high]: [[f64; 2]; 2]) -> f64 {
    let area = (high[0] - low[0]).max(0.0) * (high[1] - low[1]).max(0.0);
    pitch_mm.max((area / ENOUGH).sqrt()).min(*PITCHES_MM.end())
}

/// The surface of a shape: lines are 0.8 mm wide, dots have a diameter of 2 mm.
pub fn surface_of(shape: &Shape) -> Surface {
    let (shape, reach_mm) = match shape {
        Shape::Polyline(_) | Shape::Grating { .. } => (shape.clone(), LINE_MM / 2.0),
        Shape::Dots(_) => (shape.clone(), DOT_MM / 2.0),
        // A disc without radius is a dot.
        &Shape::Disc { center_mm, radius_mm } => (Shape::Dots(vec![center_mm]), radius_mm.max(DOT_MM / 2.0)),
    };
    Surface::Near { shape, reach_mm }
}
