//! Which unit and which up axis a file uses.
//!
//! Formats without a unit are guessed: the first of [`CANDIDATE_UNITS`] that makes the largest dimension between 0.3 and
//! 3.5 m long, the sizes of people, animals and props. What was assumed is said in a note; `--height`, `--unit` and `--up`
//! say it better.

use crate::import::ImportOptions;
use softrig::rig::Affine;

/// Metres per file unit, in the order in which they are tried: metre, centimetre, decimetre, millimetre, inch.
pub const CANDIDATE_UNITS: [f64; 5] = [1.0, 0.01, 0.1, 0.001, 0.0254];

/// Largest dimensions [m] a guess may lead to.
pub const PLAUSIBLE_SIZE: [f64; 2] = [0.3, 3.5];

/// Largest dimension [m] given to what fits no unit: a person.
const FALLBACK_SIZE: f64 = 1.7;

/// Axis of a file that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Hash)]
pub enum UpAxis {
    /// Y, as glTF has it.
    #[default]
    Y,
    /// Z, as CAD and Blender have it.
    Z,
}

/// How a file's numbers become metres with Y up.
#[derive(Clone, Debug, PartialEq)]
pub struct Units {
    /// Metres per file unit.
    pub metres: f64,
    /// Axis of the file that points up.
    pub up: UpAxis,
    /// What was assumed, in plain words; says nothing about what the options fixed.
    pub notes: Vec<String>,
}

impl Units {
    /// Chooses the unit for a shape whose box has the given edges (file axes, file units), and the up axis: the one of the
    /// options, else `usual_up`, what the format or its tools use. Never fails: what fits no unit is scaled to a person's size.
    #[must_use]
    pub fn choose(size: [f64; 3], usual_up: UpAxis, options: &ImportOptions) -> Self {
        let mut notes = Vec::new();
        let up = options.up.unwrap_or(usual_up);
        if options.up.is_none() && up == UpAxis::Z {
            notes.push("took Z as the up axis (--up Y if it is not)".into());
        }
        let height = size[if up == UpAxis::Y { 1 } else { 2 }];
        let largest = size.iter().copied().filter(|s| s.is_finite()).fold(0.0, f64::max);
        let metres = if let Some(unit) = options.unit.filter(|u| is_usable(*u)) {
            unit
        } else if let Some(unit) = options.height.map(|h| h / height).filter(|u| is_usable(*u)) {
            unit
        } else {
            if options.unit.is_some() || options.height.is_some() {
                notes.push(format!(
                    "the wanted height or unit cannot be met (the file is {height} units tall); guessed instead"
                ));
            }
            let (unit, note) = guess(largest);
            notes.push(note);
            unit
        };
        Self { metres, up, notes }
    }

    /// File units and axes to metres, Y up.
    #[must_use]
    pub fn to_world(&self) -> Affine {
        let s = self.metres;
        let linear = match self.up {
            UpAxis::Y => [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]],
            // a quarter turn about X: file Z becomes Y, file Y becomes -Z
            UpAxis::Z => [[s, 0.0, 0.0], [0.0, 0.0, s], [0.0, -s, 0.0]],
        };
        Affine { linear, translation: [0.0; 3] }
    }
}

/// Edges of the smallest box around all finite points; zero without any.
#[must_use]
pub fn box_size(points: impl IntoIterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points.into_iter().filter(|p| p.iter().all(|v| v.is_finite())) {
        for k in 0..3 {
            lo[k] = lo[k].min(p[k]);
            hi[k] = hi[k].max(p[k]);
        }
    }
    std::array::from_fn(|k| (hi[k] - lo[k]).max(0.0))
}

/// Metres per unit for a largest dimension in file units, and what to tell the user.
fn guess(largest: f64) -> (f64, String) {
    if largest <= 0.0 {
        return (1.0, "took one file unit as 1 m: the shape has no size (--unit if it is not)".into());
    }
    let fits = |u: &f64| (PLAUSIBLE_SIZE[0]..=PLAUSIBLE_SIZE[1]).contains(&(largest * u));
    match CANDIDATE_UNITS.into_iter().find(fits) {
        Some(unit) => {
            let size = largest * unit;
            let note = format!(
                "took one file unit as {unit} m, which makes it {size:.3} m at its largest (--height or --unit if it is not)"
            );
            (unit, note)
        }
        None => {
            let unit = FALLBACK_SIZE / largest;
            // sizes near the ends of f64 have no usable factor
            let unit = if is_usable(unit) { unit } else { 1.0 };
            let note = format!(
                "no usual unit fits a largest dimension of {largest} units; scaled it to {:.3} m (say --height or --unit)",
                largest * unit
            );
            (unit, note)
        }
    }
}

fn is_usable(unit: f64) -> bool {
    unit.is_finite() && unit > 1e-300
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metres(size: f64) -> f64 {
        Units::choose([size, 0.5 * size, 0.1 * size], UpAxis::Y, &ImportOptions::default()).metres
    }

    /// Largest dimensions of the sample files: CesiumMan, Fox, the MakeHuman base mesh, a hand in millimetres.
    #[test]
    fn real_sizes_find_their_unit() {
        assert_eq!([1.5, 155.0, 16.9, 1600.0].map(metres), [1.0, 0.01, 0.1, 0.001]);
        // 60 units: 0.6 m in centimetres comes before 1.5 m in inches
        assert_eq!(metres(60.0), 0.01);
    }

    #[test]
    fn a_wanted_height_holds_along_the_up_axis() {
        let options = ImportOptions { height: Some(2.0), up: Some(UpAxis::Z), ..ImportOptions::default() };
        let units = Units::choose([1.0, 2.0, 8.0], UpAxis::Y, &options);
        assert_eq!(units.to_world().point([0.0, 0.0, 8.0]), [0.0, 2.0, 0.0]);
        assert!(units.notes.is_empty());
    }

    #[test]
    fn nonsense_sizes_still_give_a_finite_map() {
        for size in [0.0, 1e-310, 1e308, f64::NAN, f64::INFINITY] {
            let options = ImportOptions { height: Some(0.0), unit: Some(f64::NAN), up: None };
            let units = Units::choose([size; 3], UpAxis::Y, &options);
            assert!(units.to_world().is_finite() && units.metres > 0.0, "{size}");
        }
    }
}
