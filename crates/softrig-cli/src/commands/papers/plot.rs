//! Line plots as SVG.

use plotters::prelude::*;

/// A named line through points.
#[derive(Clone, Debug)]
pub struct Curve<'a> {
    /// What the legend calls it.
    pub name: &'a str,
    /// The points; those that are not finite, or not positive on a logarithmic axis, are left out.
    pub points: Vec<(f64, f64)>,
}

/// A plot of curves over a linear x axis.
#[derive(Clone, Debug)]
pub struct Plot<'a> {
    /// Written above.
    pub title: &'a str,
    /// Written below the x axis, with its unit.
    pub x: &'a str,
    /// Written beside the y axis, with its unit.
    pub y: &'a str,
    /// Whether the y axis is logarithmic.
    pub log: bool,
    /// What is drawn.
    pub curves: Vec<Curve<'a>>,
}

const SIZE: (u32, u32) = (760, 460);

impl Plot<'_> {
    /// The plot as the text of an SVG file.
    pub fn svg(&self) -> String {
        let mut text = String::new();
        // drawing into a string cannot fail, but for axes without extent, which `span` excludes
        let _ = self.draw(SVGBackend::with_string(&mut text, SIZE).into_drawing_area());
        text
    }

    fn points<'a>(&'a self, curve: &'a Curve<'_>) -> impl Iterator<Item = (f64, f64)> + Clone + 'a {
        let fits = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite() && (!self.log || p.1 > 0.0);
        curve.points.iter().copied().filter(fits)
    }

    fn draw<D: DrawingBackend>(
        &self,
        area: DrawingArea<D, plotters::coord::Shift>,
    ) -> Result<(), DrawingAreaErrorKind<D::ErrorType>> {
        area.fill(&WHITE)?;
        let all = || self.curves.iter().flat_map(|c| self.points(c));
        let (x, y) = (span(all().map(|p| p.0), false), span(all().map(|p| p.1), self.log));
        let mut chart = ChartBuilder::on(&area);
        chart.caption(self.title, ("sans-serif", 17)).margin(12).x_label_area_size(42).y_label_area_size(64);
        if self.log {
            let mut chart = chart.build_cartesian_2d(x.0..x.1, (y.0..y.1).log_scale())?;
            let label = |v: &f64| format!("{v:.0e}");
            chart.configure_mesh().x_desc(self.x).y_desc(self.y).y_label_formatter(&label).draw()?;
            for (k, curve) in self.curves.iter().enumerate() {
                let colour = COLOURS[k % COLOURS.len()];
                let drawn =
                    chart.draw_series(LineSeries::new(self.points(curve), colour.stroke_width(2)).point_size(2))?;
                drawn
                    .label(curve.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
            }
            legend(&mut chart)?;
        } else {
            let mut chart = chart.build_cartesian_2d(x.0..x.1, y.0..y.1)?;
            chart.configure_mesh().x_desc(self.x).y_desc(self.y).draw()?;
            for (k, curve) in self.curves.iter().enumerate() {
                let colour = COLOURS[k % COLOURS.len()];
                let drawn =
                    chart.draw_series(LineSeries::new(self.points(curve), colour.stroke_width(2)).point_size(2))?;
                drawn
                    .label(curve.name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
            }
            legend(&mut chart)?;
        }
        area.present()
    }
}

const COLOURS: [RGBColor; 6] = [
    RGBColor(200, 40, 40),
    RGBColor(30, 90, 190),
    RGBColor(40, 140, 60),
    RGBColor(225, 115, 10),
    RGBColor(120, 50, 160),
    RGBColor(90, 90, 90),
];

fn legend<'a, D: DrawingBackend + 'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, D, C>,
) -> Result<(), DrawingAreaErrorKind<D::ErrorType>> {
    // curves fall from the upper left
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .margin(14)
        .border_style(BLACK.mix(0.4))
        .background_style(WHITE.mix(0.85))
        .draw()
}

/// Where an axis begins and ends so that all values are on it.
fn span(values: impl Iterator<Item = f64>, log: bool) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return (1.0, 10.0);
    }
    if log {
        return (0.7 * low, 1.4 * high);
    }
    let extra = if high > low { 0.05 * (high - low) } else { 0.5 };
    (low.min(0.0), high + extra)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_names_its_curves_and_survives_odd_numbers() {
        let curve = |name, points| Curve { name, points };
        let mut plot = Plot {
            title: "Residual",
            x: "time [ms]",
            y: "relative residual [-]",
            log: true,
            curves: vec![
                curve("multigrid", vec![(0.0, 1.0), (1.0, 1e-3), (2.0, f64::NAN), (3.0, 0.0)]),
                curve("nothing", Vec::new()),
            ],
        };
        for log in [true, false] {
            plot.log = log;
            let svg = plot.svg();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
            assert!(["Residual", "time [ms]", "multigrid"].iter().all(|t| svg.contains(t)) && !svg.contains("NaN"));
        }
        plot.curves.clear();
        assert!(plot.svg().contains("</svg>"));
    }
}
