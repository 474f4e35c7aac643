//! Spikes under objects: against the second model's pins, and of moving objects.

use meissner_skin::AnyScene;
use meissner_skin::Keep;
use meissner_skin::afferents::{Afferent, Scene, population, simulate};
use meissner_touch::{Contact, Grains, Pose, Touch, respond};

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
