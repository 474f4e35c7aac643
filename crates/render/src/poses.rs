//! Heights of the pins for one pose of an object at a time: for poses that are not known before, as those of a live play.
//!
//! [`Poses::new`] solves the object's contact and tabulates the skin about it ([`Imprint`]). [`Poses::heights_mm`] then looks up the skin
//! at the places of a [`Skin`], takes the products with the pins' shapes, and solves the bounded least squares of `field`, one height
//! after the other (projected Gauss-Seidel; the matrix is positive definite, so it converges: Luo & Tseng 1992).
//!
//! The part of the object within [`PART_MM`] of its frame's origin presses as one, wherever it lies: in [`render`](crate::render) only
//! what passes under the finger does. The two are the same for an object that stays under the finger.
//!
//! Invariant: heights are within the travel of the motors, and depend on the object and the pose alone, not on poses before.
//!
//! # Source
//!
//! Z.-Q. Luo and P. Tseng, "On the convergence of the coordinate descent method for convex differentiable minimization", *Journal of
//! Optimization Theory and Applications* 72, 7-35, 1992.

use crate::field::DAMPING;
use crate::levels::Limits;
use crate::skin::{SPACING_MM, Skin, dot};
use meissner_array::spec::Array;
use meissner_skin::membrane::PAD_LENGTH_MM;
use meissner_touch::{Contact, ContactError, Imprint, MARGIN_MM, MAX_DEPTH_MM, Object, Pose};

/// How far the part of an object that presses reaches along each axis of its frame, mm.
pub const PART_MM: f64 = 25.0;
/// How far an object's origin may be from the array's middle, mm: the pad's length.
const FAR_MM: f64 = PAD_LENGTH_MM;
/// The same for an object that is larger than [`PART_MM`]: beyond it, the rim of the part would come under the finger.
const NEAR_MM: f64 = PART_MM - PAD_LENGTH_MM / 2.0 - MARGIN_MM;
/// The largest turn, degrees.
const MOST_DEG: f64 = 1e6;
/// Heights are found when none changes by more than this, mm.
const TOLERANCE_MM: f64 = 1e-5;
/// More sweeps over the pins than any pose needs.
const SWEEPS: usize = 100;

/// Why there are no heights.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum PosesError {
    #[error(
        "the object {name} moves by itself: poses move a live object, give it `press` in place of a scan or a path"
    )]
    Moves { name: String },
    #[error(
        "the object {name} has nothing within {PART_MM} mm of its origin: move its material nearer to its frame's origin"
    )]
    Nowhere { name: String },
    #[error("the object {name} takes too long or too much memory: {error}")]
    Contact { name: String, error: ContactError },
    #[error("the pose's {what} is {found}: must be {least} to {most} {unit}")]
    Range { what: &'static str, found: f64, least: f64, most: f64, unit: &'static str },
    #[error(
        "the pose takes the object's origin {found:.1} mm from the array's middle: at most {most} mm{why}, send a nearer pose"
    )]
    Far { found: f64, most: f64, why: &'static str },
}

/// The heights of an array's pins for any pose of an object.
///
/// ```
/// use meissner_array::spec::Array;
/// use meissner_render::Poses;
/// use meissner_touch::{Object, Pose, Surface, Touch};
///
/// let bar = Surface::Polygons(vec![vec![[-6.0, -0.4], [6.0, -0.4], [6.0, 0.4], [-6.0, 0.4]]]);
/// let poses = Poses::new(Array::paper(), &Object::new("bar", bar, Touch::default()))?;
/// let heights_mm = poses.heights_mm(&Pose { y_mm: 0.8, angle_deg: 30.0, depth_mm: 0.5, ..Pose::default() })?;
/// assert!(heights_mm.len() == 24 && heights_mm.iter().any(|mm| *mm > 0.2));
/// # Ok::<(), meissner_render::PosesError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Poses {
    skin: Skin,
    /// By motor: products of its pin's shape with those of all pins.
    matrix: Vec<Vec<f64>>,
    highest_mm: f64,
    imprint: Imprint,
    /// Where the object is without a pose, and how deep.
    place: Pose,
    far_mm: f64,
}

impl Poses {
    /// Prepares an object: 10 ms to some seconds and up to 256 MB, by its size, and less if it is flat.
    ///
    /// # Errors
    /// If the object's touch moves it, nothing of it lies near its origin, or its contact takes too much memory or time.
    pub fn new(array: Array, object: &Object) -> Result<Self, PosesError> {
        let name = || object.name().to_owned();
        if !object.touch().stays_in_place() {
            return Err(PosesError::Moves { name: name() });
        }
        let grains = object.grains_within(PART_MM, MAX_DEPTH_MM);
        if grains.is_empty() {
            return Err(PosesError::Nowhere { name: name() });
        }
        let far_mm = if object.is_within(PART_MM) { FAR_MM } else { NEAR_MM };
        let imprint = Contact::new(grains, MAX_DEPTH_MM)
            .and_then(|contact| Imprint::new(contact, far_mm + PAD_LENGTH_MM / 2.0))
            .map_err(|error| PosesError::Contact { name: name(), error })?;
        let skin = Skin::new(array, SPACING_MM);
        let matrix = skin.products(DAMPING);
        let place = Pose { depth_mm: object.touch().most_depth_mm(), ..object.touch().pose(0.0) };
        Ok(Self { skin, matrix, highest_mm: Limits::of(array).highest_mm, imprint, place, far_mm })
    }

    /// The same with no pin above this, mm.
    pub fn at_most(self, mm: f64) -> Self {
        Self { highest_mm: self.highest_mm.min(mm.max(0.0)), ..self }
    }

    /// The depth of the object's own press, mm.
    pub const fn depth_mm(&self) -> f64 {
        self.place.depth_mm
    }

    /// The contact of the object's part.
    pub const fn contact(&self) -> &Contact {
        self.imprint.contact()
    }

    /// The height of every pin above rest, mm, by motor. The pose turns the object from where its file places it about the array's middle, by
    /// `angle_deg` anticlockwise, and then shifts it by `x_mm` and `y_mm`; its highest point is `depth_mm` below the surface of the skin at rest.
    ///
    /// # Errors
    /// If a number is beyond its limit: 2 mm of depth, and 24 mm from the array's middle to the object's origin, 12 mm if the
    /// object is larger than [`PART_MM`] to each side.
    pub fn heights_mm(&self, pose: &Pose) -> Result<Vec<f64>, PosesError> {
        let wanted = self.imprint.displacements_mm(&self.moved(pose)?, &self.skin.places_mm);
        let mut wish = vec![0.0; self.skin.motors];
        self.skin.onto(&wanted, &mut wish);
        let mut heights_mm = vec![0.0_f64; self.skin.motors];
        for _ in 0..SWEEPS {
            let mut changed_mm = 0.0_f64;
            for (motor, (row, wish)) in self.matrix.iter().zip(&wish).enumerate() {
                let height = heights_mm[motor] - (dot(row, &heights_mm) - wish) / row[motor];
                let height = height.clamp(0.0, self.highest_mm);
                changed_mm = changed_mm.max((height - heights_mm[motor]).abs());
                heights_mm[motor] = height;
            }
            if changed_mm <= TOLERANCE_MM {
                break;
            }
        }
        Ok(heights_mm)
    }

    /// The pose of the object's frame.
    fn moved(&self, pose: &Pose) -> Result<Pose, PosesError> {
        for (what, found, least, most, unit) in [
            ("x_mm", pose.x_mm, -FAR_MM, FAR_MM, "mm"),
            ("y_mm", pose.y_mm, -FAR_MM, FAR_MM, "mm"),
            ("angle_deg", pose.angle_deg, -MOST_DEG, MOST_DEG, "degrees"),
            ("depth_mm", pose.depth_mm, 0.0, MAX_DEPTH_MM, "mm"),
        ] {
            if !(least..=most).contains(&found) {
                return Err(PosesError::Range { what, found, least, most, unit });
            }
        }
        // The remainder is exact; the sine of many turns is not.
        let turn_deg = pose.angle_deg % 360.0;
        let (sin, cos) = (libm::sin(turn_deg.to_radians()), libm::cos(turn_deg.to_radians()));
        let Pose { x_mm, y_mm, angle_deg, .. } = self.place;
        let moved = Pose {
            x_mm: x_mm * cos - y_mm * sin + pose.x_mm,
            y_mm: x_mm * sin + y_mm * cos + pose.y_mm,
            angle_deg: angle_deg + turn_deg,
            depth_mm: pose.depth_mm,
        };
        let found = libm::hypot(moved.x_mm, moved.y_mm);
        if found > self.far_mm {
            let why = if self.far_mm < FAR_MM { " for an object that is larger than the finger" } else { "" };
            return Err(PosesError::Far { found, most: self.far_mm, why });
        }
        Ok(moved)
    }
}
