//! A real object on a finger: what it is, how it touches, and what the afferents answer.
//!
//! The response of the same finger to the real object is what a pattern of pins should come near to. The data path:
//!
//! 0. `shape`: a [`Shape`] on the skin, and the distance of a place from it. `braille`: the dots of a Braille character.
//! 1. `touch`: a [`Touch`] is the pose and the depth of an object over time: a press, a scan or a path.
//! 2. `object`: an [`Object`] has a surface and a touch. It is made in memory, or read from a file.
//! 3. `grains`: the part of the object under the finger becomes [`Grains`], flat round discs on a regular grid.
//! 4. `contact`: [`Contact::new`] solves the loads of the grains on the skin, an elastic half space, at all depths of the touch. `fft`
//!    convolves loads with the skin's flexibility.
//! 5. `timeline`: where the object is at each sample, and how loads at that depth follow from the solved ones.
//! 6. `field`: what the loads do to the skin, as tables in the object's frame, for objects that move.
//! 7. `skin`: [`displacements_mm`] gives the displacement of the skin at any places and times.
//! 8. `imprint`: an [`Imprint`] is the skin about an object at any pose, for poses that are not known before.
//! 9. `response`: [`respond`] gives the spikes of afferents of the second model of [`meissner_skin`].
//!
//! The half space has no edge and the object is rigid, so loads depend on the depth alone. The pose only moves them over the skin.
//! There is no friction, and the skin follows at once. `docs/models.md` shows the limits of this.
//!
//! Invariant: results depend on the object, the pitch of its grains, the afferents and the seed alone, bit for bit, on every machine and
//! for any number of threads. The crate opens no file and reads no clock.
//!
//! # Example
//!
//! ```
//! use meissner_skin::afferents::population;
//! use meissner_touch::{Contact, Object, Surface, Touch, respond};
//!
//! let bar = Surface::Polygons(vec![vec![[-6.0, -0.4], [6.0, -0.4], [6.0, 0.4], [-6.0, 0.4]]]);
//! let object = Object::new("bar", bar, Touch::default());
//! let grains = object.grains(object.pitch_mm());
//! let contact = Contact::new(grains, object.touch().most_depth_mm())?;
//! let spikes_s = respond(&contact, object.touch(), &population(1), Some(0), &|_| ());
//! assert!(spikes_s.iter().map(Vec::len).sum::<usize>() > 100);
//! # Ok::<(), meissner_touch::ContactError>(())
//! ```

mod braille;
mod contact;
mod fft;
mod field;
mod grains;
mod imprint;
mod object;
mod response;
mod shape;
mod skin;
mod timeline;
mod touch;

pub use braille::dots as braille_dots;
pub use contact::{Contact, ContactError, DEPTHS, MAX_BYTES, bytes, solve};
pub use grains::Grains;
pub use imprint::Imprint;
pub use object::{
    DOT_MM, Drawn, HeightMap, LINE_MM, MARGIN_MM, MAX_FILE_BYTES, MAX_PIXELS, MAX_POINTS, MAX_SIDE_MM,
    Object, ObjectError, Open, PITCHES_MM, Problem, Surface, no_files, surface_of,
};
pub use response::respond;
pub use shape::{Shape, direction, distance, on_pad, to_segment};
pub use skin::displacements_mm;
pub use touch::{
    MAX_DEPTH_MM, MAX_PLACE_MM, MAX_POSES, MAX_PRESS_MM_S, MAX_SPEED_MM_S, MAX_TOUCH_S, MAX_TURN_DEG_S, Pose,
    Press, Scan, Touch, TouchError,
};
