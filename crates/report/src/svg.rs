//! A drawing of shapes, lines and text as SVG, for maps and charts.
//!
//! Coordinates are pixels from the upper left corner. Numbers are written with two decimals.
//!
//! Invariant: text is escaped and elements are closed, so every drawing is well formed.

/// Escapes text for SVG and HTML, attributes included.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Other control characters are not allowed, not even escaped.
            c if c.is_control() && !matches!(c, '\n' | '\t') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Which point of a text lies at its coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// An unfinished drawing.
#[derive(Debug)]
pub(crate) struct Drawing {
    width: f64,
    height: f64,
    elements: String,
}

/// The CSS colours of a closed shape.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paint<'a> {
    pub(crate) fill: &'a str,
    pub(crate) stroke: &'a str,
}

impl Drawing {
    pub(crate) const fn new(width: f64, height: f64) -> Self {
        Self { width, height, elements: String::new() }
    }

    pub(crate) fn circle(&mut self, (x, y): (f64, f64), radius: f64, paint: Paint<'_>) {
        self.ellipse((x, y), (radius, radius), paint);
    }

    pub(crate) fn ellipse(&mut self, (x, y): (f64, f64), (rx, ry): (f64, f64), paint: Paint<'_>) {
        let Paint { fill, stroke } = paint;
        self.element(&format!(
            r#"<ellipse cx="{x:.2}" cy="{y:.2}" rx="{rx:.2}" ry="{ry:.2}" fill="{fill}" stroke="{stroke}"/>"#
        ));
    }

    pub(crate) fn rectangle(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), paint: Paint<'_>) {
        let Paint { fill, stroke } = paint;
        self.element(&format!(
            r#"<rect x="{x:.2}" y="{y:.2}" width="{width:.2}" height="{height:.2}" fill="{fill}" stroke="{stroke}"/>"#
        ));
    }

    /// An open line from point to point.
    pub(crate) fn line(&mut self, points: &[(f64, f64)], width: f64, color: &str) {
        let points = listed(points);
        self.element(&format!(
            r#"<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width}" stroke-linecap="round"/>"#
        ));
    }

    /// An open line of dashes; `dash` lists their lengths and those of the gaps, px.
    pub(crate) fn dashed(&mut self, points: &[(f64, f64)], width: f64, color: &str, dash: &str) {
        let points = listed(points);
        self.element(&format!(
            r#"<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width}" stroke-dasharray="{dash}"/>"#
        ));
    }

    /// A filled shape with these corners.
    pub(crate) fn polygon(&mut self, corners: &[(f64, f64)], color: &str) {
        self.element(&format!(r#"<polygon points="{}" fill="{color}"/>"#, listed(corners)));
    }

    pub(crate) fn words(&mut self, at: (f64, f64), size: u32, anchor: Anchor, color: &str, words: &str) {
        self.text(at, size, anchor, color, words, "");
    }

    /// Text that runs upwards.
    pub(crate) fn turned(&mut self, (x, y): (f64, f64), size: u32, anchor: Anchor, color: &str, words: &str) {
        self.text((x, y), size, anchor, color, words, &format!(r#" transform="rotate(-90 {x:.2} {y:.2})""#));
    }

    fn text(
        &mut self,
        (x, y): (f64, f64),
        size: u32,
        anchor: Anchor,
        color: &str,
        words: &str,
        transform: &str,
    ) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let words = escape(words);
        self.element(&format!(
            r#"<text x="{x:.2}" y="{y:.2}" font-size="{size}" text-anchor="{anchor}" fill="{color}"{transform}>{words}</text>"#
        ));
    }

    fn element(&mut self, element: &str) {
        self.elements.push_str(element);
        self.elements.push('\n');
    }

    /// The text of an SVG file.
    pub(crate) fn finish(self) -> String {
        let Self { width, height, elements } = self;
        format!(
            r##"<svg width="{width:.0}" height="{height:.0}" viewBox="0 0 {width:.0} {height:.0}" xmlns="http://www.w3.org/2000/svg" font-family="sans-serif">
<rect width="100%" height="100%" fill="#ffffff"/>
{elements}</svg>
"##
        )
    }
}

fn listed(points: &[(f64, f64)]) -> String {
    points.iter().map(|(x, y)| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_leave_its_element() {
        let mut drawing = Drawing::new(10.0, 20.0);
        drawing.words((1.0, 2.0), 9, Anchor::Middle, "#000", "</text><script>\"&'\u{1}");
        let svg = drawing.finish();
        assert!(svg.contains("&lt;/text&gt;&lt;script&gt;&quot;&amp;&#39;\u{fffd}</text>"), "{svg}");
        assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    }
}
