//! Prints speed against accuracy of rendering, and what motors carry of textures.

use meissner::cli::columns;
use meissner_research::{RenderingFigures, RenderingRow, TextureFigures, TextureRow};

pub(crate) fn table(found: &RenderingFigures) -> Vec<String> {
    let head =
        ["object", "varied", "grain mm", "places mm", "steps", "error SA1", "RA", "contact ms", "heights ms"];
    let row = |row: &RenderingRow| {
        vec![
            row.object.clone(),
            row.what.clone(),
            row.grain_mm.to_string(),
            row.spacing_mm.to_string(),
            row.steps.to_string(),
            format!("{:.2}", row.errors[0]),
            format!("{:.2}", row.errors[1]),
            format!("{:.0}", row.contact_ms),
            format!("{:.0}", row.heights_ms),
        ]
    };
    vec![
        "Error of the blurred response in windows of 36 ms, against the object in grains of 0.1 mm: method auto, mean over fingers."
            .to_owned(),
        columns(&head, found.rows.iter().map(row)),
    ]
}

pub(crate) fn textures(found: &TextureFigures) -> Vec<String> {
    let head = ["mm/s", "felt", "r RA", "r PC", "error RA", "PC", "spikes RA", "PC"];
    let row = |row: &TextureRow| {
        let mut cells = vec![row.speed_mm_s.to_string(), row.felt.to_owned()];
        let numbers = [row.r, row.errors, row.spikes].concat();
        cells.extend(numbers.iter().map(|number| format!("{number:.2}")));
        cells
    };
    vec![
        "A rough profile of 0.2 mm peak to peak, wavelengths of 1 to 6 mm, pressed by 0.4 mm: against the real response in windows of 36 ms, mean over fingers."
            .to_owned(),
        columns(&head, found.rows.iter().map(row)),
    ]
}
