//! Spikes under objects: against the second model's pins, and of moving objects.

use meissner_skin::AnyScene;
use meissner_skin::Keep;
use meissner_skin::afferents::{Afferent, Class, Scene, population, simulate};
use meissner_touch::{
    Contact, Grains, HeightMap, MAX_BYTES, Object, Pose, Press, Scan, Surface, Touch, bytes,
    displacements_mm, respond,
};

/// The afferents of a scene's lines.
fn lines(afferents: &[Afferent]) -> String {
    let line = |of: &Afferent| {
        format!(
            "[[afferents]]\nclass = \"{}\"\nrow = {}\nx_mm = {}\ny_mm = {}\n",
            of.class.name(),
            of.row,
            of.at.x_mm,
            of.at.y_mm
        )
    };
    afferents.iter().map(line).collect()
}

/// The pins of the paper's array as an object.
fn pins() -> Grains {
    let cells = (0..24).map(|pin| [pin % 4, pin / 4]).collect();
    Grains::new(2.9, 0.5, [-4.35, -7.25], cells, vec![0.0; 24])
}

fn scene(afferents: &[Afferent], noise: bool) -> Scene {
    let pin = |place: &[f64; 2]| {
        format!(
            "[[pins]]\nx_mm = {}\ny_mm = {}\nfrequency_hz = 0.0\namplitude_um = 0.0\nphase = 0.0\n",
            place[0], place[1]
        )
    };
    let pins: String = pins().places_mm.iter().map(pin).collect();
    let text = format!(
        "model = \"afferents\"\nduration_s = 0.4\nseed = 7\npreindent_mm = 0.5\nramp_s = 0.1\nbegin_s = 1.0\nnoise = {noise}\n{pins}{}",
        lines(afferents)
    );
    match AnyScene::read(&text, "scene.toml", None) {
        Ok(AnyScene::Afferents(scene)) => scene,
        other => panic!("{other:?}"),
    }
}

#[test]
fn pins_as_an_object_make_the_spikes_of_the_second_models_pins() {
    let afferents = population(3);
    let touch = Touch::path(vec![
        (0.0, Pose::default()),
        (0.1, Pose { depth_mm: 0.5, ..Pose::default() }),
        (0.4, Pose { depth_mm: 0.5, ..Pose::default() }),
    ])
    .unwrap();
    let contact = Contact::new(pins(), 0.5).unwrap();
    for noise in [false, true] {
        let expected = simulate(&scene(&afferents, noise), Keep::Spikes, &|_| ()).unwrap().spikes_s.unwrap();
        let found = respond(&contact, &touch, &afferents, noise.then_some(7), &|_| ());
        assert!(count(&expected) > 300);
        assert_eq!(found, expected);
    }
}

fn count(spikes: &[Vec<f64>]) -> usize {
    spikes.iter().map(Vec::len).sum()
}

/// A bar of 12 × 0.8 mm across the finger, at the origin of its frame.
fn bar(touch: Touch) -> Object {
    let corners = vec![[-6.0, -0.4], [6.0, -0.4], [6.0, 0.4], [-6.0, 0.4]];
    Object::new("bar", Surface::Polygons(vec![corners]), touch)
}

fn solved(object: &Object, pitch_mm: f64) -> Contact {
    Contact::new(object.grains(pitch_mm), object.touch().most_depth_mm()).expect("a small contact")
}

fn counts(spikes: &[Vec<f64>], afferents: &[Afferent]) -> [usize; 3] {
    Class::ALL.map(|class| {
        let of_class = spikes.iter().zip(afferents).filter(|(_, afferent)| afferent.class == class);
        of_class.map(|(spikes, _)| spikes.len()).sum()
    })
}

/// A place that does not move, by way of the tables of a moving object: the path turns the disc about its middle.
#[test]
fn the_tables_of_a_moving_object_give_the_response_of_one_at_rest() {
    let afferents = population(3);
    let pose = |angle_deg, depth_mm| Pose { angle_deg, depth_mm, ..Pose::default() };
    let touch = |turn| {
        Touch::path(vec![
            (0.0, pose(0.0, 0.0)),
            (0.05, pose(0.0, 0.5)),
            (0.3, pose(0.0, 0.5)),
            (0.31, pose(turn, 0.5)),
        ])
        .unwrap()
    };
    let [rest, turned] = [0.0, 1e-9].map(|turn| bar(touch(turn)));
    assert!(rest.touch().stays_in_place() && !turned.touch().stays_in_place());
    let contact = solved(&rest, 0.1);
    let places: Vec<[f64; 2]> =
        (0..40).map(|n| [0.2 * f64::from(n % 20) - 2.0, 0.21 * f64::from(n / 20)]).collect();
    let [exact, tables] =
        [&rest, &turned].map(|object| displacements_mm(&contact, object.touch(), &places, &[0.02, 0.2]));
    for (exact, tables) in exact.iter().flatten().zip(tables.iter().flatten()) {
        assert!((exact - tables).abs() < 0.01 * exact + 0.001, "{exact} {tables}");
    }
    let [exact, tables] = [&rest, &turned]
        .map(|object| counts(&respond(&contact, object.touch(), &afferents, None, &|_| ()), &afferents));
    for (exact, tables) in exact.into_iter().zip(tables) {
        assert!(exact.abs_diff(tables) <= 2 + exact / 20, "{exact} {tables}");
    }
}

fn moving(speed_mm_s: f64) -> Object {
    let duration_s = 16.0 / speed_mm_s;
    let scan = Scan { depth_mm: 0.5, rise_s: 0.05, speed_mm_s, direction_deg: 90.0, duration_s };
    bar(Touch::scan(Pose::default(), scan).expect("a scan"))
}

#[test]
fn results_do_not_depend_on_threads() {
    let (object, afferents) = (moving(80.0), population(3));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| respond(&solved(&object, 0.4), object.touch(), &afferents, Some(1), &|_| ()))
    };
    assert!(run(1) == run(3));
}

/// Everything is finite and within the bound of memory.
#[test]
fn extremes() {
    let afferents = population(3);
    let press = |depth_mm| {
        Touch::press(Pose::default(), Press { depth_mm, rise_s: 0.02, hold_s: 0.03, fall_s: 0.02 }).unwrap()
    };
    let square = |side: f64| {
        let half = side / 2.0;
        Surface::Polygons(vec![vec![[-half, -half], [half, -half], [half, half], [-half, half]]])
    };
    // A checkerboard of 0.2 mm.
    let board = |columns: usize| {
        let heights = (0..columns * columns)
            .map(|n| if (n % columns + n / columns).is_multiple_of(2) { 0.0 } else { -0.1 });
        Surface::Map(HeightMap::new([columns; 2], [0.2; 2], heights.collect()).unwrap())
    };
    let fast = Scan { depth_mm: 0.5, rise_s: 0.02, speed_mm_s: 300.0, direction_deg: 30.0, duration_s: 0.1 };
    let away = Pose { x_mm: 60.0, ..Pose::default() };
    for (name, surface, touch, fires) in [
        ("needle", square(0.1), press(0.5), true),
        ("needle, deep", square(0.1), press(2.0), true),
        ("plate", square(60.0), press(0.5), true),
        ("plate, deep", square(60.0), press(2.0), true),
        ("light", square(4.0), press(0.01), true),
        ("checkerboard", board(50), press(0.5), true),
        ("fast", square(0.8), Touch::scan(Pose::default(), fast).unwrap(), true),
        ("fast checkerboard", board(20), Touch::scan(Pose::default(), fast).unwrap(), true),
        (
            "away",
            square(4.0),
            Touch::press(away, Press { depth_mm: 1.0, rise_s: 0.02, hold_s: 0.0, fall_s: 0.02 }).unwrap(),
            false,
        ),
    ] {
        let object = Object::new(name, surface, touch);
        let grains = object.grains(object.pitch_mm());
        assert!(bytes(&grains) < MAX_BYTES, "{name}: {}", bytes(&grains));
        let contact = Contact::new(grains, object.touch().most_depth_mm()).unwrap();
        let loads = contact.loads_n(object.touch().most_depth_mm());
        assert!(loads.iter().all(|load| load.is_finite() && *load >= 0.0), "{name}");
        let spikes = respond(&contact, object.touch(), &afferents, None, &|_| ());
        assert_eq!(count(&spikes) > 0, fires, "{name}");
        assert!(spikes.iter().flatten().all(|at_s| *at_s < object.touch().duration_s()), "{name}");
    }
    let grains = Object::new("plate", square(60.0), press(0.5)).grains(0.05);
    assert!(bytes(&grains) < MAX_BYTES, "{}", bytes(&grains));
}
