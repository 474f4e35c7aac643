//! Heights of one pose at a time, against those of a whole press.

use crate::{contact, moving};
use meissner_array::spec::Array;
use meissner_render::{Method, Poses, PosesError, render};
use meissner_touch::{HeightMap, Object, Pose, Press, Shape, Surface, Touch, surface_of};

/// The moment in the middle of the press, with the pins at their heights.
const HELD: usize = 25;

fn pressed_at(pose: Pose) -> Touch {
    let press = Press { depth_mm: pose.depth_mm, rise_s: 0.05, hold_s: 0.1, fall_s: 0.05 };
    Touch::press(Pose { depth_mm: 0.0, ..pose }, press).unwrap()
}

/// A sphere of 8 mm radius, 6 mm of it, in pixels of 0.2 mm.
fn sphere() -> Surface {
    let height_mm = |pixel: usize| {
        let [x, y] = [pixel % 30, pixel / 30].map(|index| 0.2 * index as f32 - 2.9);
        -(x * x + y * y) / 16.0
    };
    Surface::Map(HeightMap::new([30; 2], [0.2; 2], (0..900).map(height_mm).collect()).unwrap())
}

fn bar() -> Surface {
    Surface::Polygons(vec![vec![[-6.0, -0.4], [6.0, -0.4], [6.0, 0.4], [-6.0, 0.4]]])
}

/// The differences come from the table, which has no roughness of grains, and from the steps of both solvers: at most 10 µm of 400.
#[test]
fn a_pose_has_the_heights_of_a_press_there() {
    let dots = surface_of(&Shape::Dots(vec![[-2.9, 2.9], [-2.9, -2.9], [2.9, -2.9]]));
    for (name, surface) in [("bar", bar()), ("dots", dots), ("sphere", sphere())] {
        let poses =
            Poses::new(Array::paper(), &Object::new(name, surface.clone(), Touch::default())).unwrap();
        let mut worst_um = 0.0_f64;
        for number in 0..12 {
            let number = f64::from(number);
            let pose = Pose {
                x_mm: 2.0 * libm::sin(number),
                y_mm: 3.0 * libm::cos(1.7 * number),
                angle_deg: 25.0 * number,
                depth_mm: 0.1 + 0.08 * number,
            };
            let object = Object::new(name, surface.clone(), pressed_at(pose));
            let (levels, _) = render(Array::paper(), &contact(&object), object.touch(), Method::Field);
            let heights_mm = poses.heights_mm(&pose).unwrap();
            let apart = heights_mm.iter().zip(&levels.heights_mm[HELD]).map(|(a, b)| (a - b).abs());
            let apart_um = 1e3 * apart.fold(0.0, f64::max);
            println!("{name} {pose:?}: {apart_um:.2} um");
            worst_um = worst_um.max(apart_um);
        }
        assert!(worst_um < 10.0, "{name}: {worst_um}");
    }
}

#[test]
fn a_pose_or_an_object_beyond_the_limits_is_refused() {
    let poses = |surface, touch| Poses::new(Array::paper(), &Object::new("thing", surface, touch));
    let bar_poses = poses(bar(), Touch::default()).unwrap();
    let at = |x_mm, y_mm, depth_mm| Pose { x_mm, y_mm, depth_mm, ..Pose::default() };
    let says = |pose: Pose, says: &str| {
        let said = bar_poses.heights_mm(&pose).unwrap_err().to_string();
        assert!(said.contains(says) && !said.contains('\n'), "{said}");
    };
    says(at(f64::NAN, 0.0, 0.5), "x_mm is NaN: must be -24 to 24 mm");
    says(at(0.0, 0.0, 2.5), "depth_mm is 2.5: must be 0 to 2 mm");
    says(at(20.0, 20.0, 0.5), "28.3 mm from the array's middle: at most 24 mm");
    assert_eq!(bar_poses.heights_mm(&at(0.0, 0.0, 0.0)).unwrap(), [0.0; 24]);
    assert!(bar_poses.heights_mm(&at(24.0, 0.0, 0.5)).unwrap().iter().all(|mm| *mm < 0.1));
    let plate = Surface::Polygons(vec![vec![[-40.0, -40.0], [40.0, -40.0], [40.0, 0.0], [-40.0, 0.0]]]);
    let edge = poses(plate, Touch::default()).unwrap();
    let far = edge.heights_mm(&at(13.0, 0.0, 0.5)).unwrap_err().to_string();
    assert!(far.contains("at most 12 mm for an object that is larger"), "{far}");
    let moves = poses(bar(), moving(20.0).touch().clone()).unwrap_err();
    assert!(matches!(moves, PosesError::Moves { .. }), "{moves}");
    let away = Surface::Polygons(vec![vec![[40.0, 0.0], [41.0, 0.0], [41.0, 1.0], [40.0, 1.0]]]);
    assert!(matches!(poses(away, Touch::default()).unwrap_err(), PosesError::Nowhere { .. }));
}

/// The pose turns the object about the array's middle from where its file places it, and then shifts it.
#[test]
fn a_pose_counts_from_where_the_object_is() {
    let placed = pressed_at(Pose { x_mm: 2.0, y_mm: 0.0, angle_deg: 20.0, depth_mm: 0.5 });
    let poses = |touch| Poses::new(Array::paper(), &Object::new("bar", bar(), touch)).unwrap();
    let from_there = Pose { x_mm: 0.5, y_mm: 1.0, angle_deg: 90.0, depth_mm: 0.4 };
    let from_the_middle = Pose { x_mm: 0.5, y_mm: 3.0, angle_deg: 110.0, depth_mm: 0.4 };
    let found = poses(placed).heights_mm(&from_there).unwrap();
    let wanted = poses(Touch::default()).heights_mm(&from_the_middle).unwrap();
    assert!(found.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?} {wanted:?}");
}
