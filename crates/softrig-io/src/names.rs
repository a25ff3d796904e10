//! Names that are unique, and safe as file names.

use std::collections::HashSet;

/// Longest name kept [bytes]: file systems stop at 255, and endings and numbers follow.
const LONGEST: usize = 120;

/// Hands out names, each only once; upper and lower case count as equal, as on many file systems.
#[derive(Debug, Default)]
pub(crate) struct Names {
    taken: HashSet<String>,
    /// Last number tried per base name: keeps many equal names from costing quadratic time.
    last: std::collections::HashMap<String, usize>,
}

impl Names {
    /// The wished name, or with `_2`, `_3`, ... behind it when it is taken.
    pub fn unique(&mut self, wish: &str) -> String {
        if self.taken.insert(wish.to_lowercase()) {
            return wish.into();
        }
        let last = self.last.entry(wish.to_lowercase()).or_insert(1);
        loop {
            *last += 1;
            let name = format!("{wish}_{last}");
            if self.taken.insert(name.to_lowercase()) {
                return name;
            }
        }
    }
}

/// A name made safe as a file name on every system: no separators, control characters or device names, never empty.
pub(crate) fn file_name(wish: &str, otherwise: &str) -> String {
    let mut out = String::new();
    for c in wish.trim().chars() {
        let c = if c.is_control() || r#"/\:*?"<>|"#.contains(c) { '_' } else { c };
        if out.len() + c.len_utf8() > LONGEST {
            break;
        }
        out.push(c);
    }
    // Windows drops these at the end; a leading dot hides a file, or means a folder
    let safe = out.trim_end_matches(['.', ' ']).trim_start_matches('.');
    if safe.is_empty() {
        return otherwise.into();
    }
    let stem = safe.split('.').next().unwrap_or_default().to_ascii_uppercase();
    let numbered = |p: &str| stem.strip_prefix(p).is_some_and(|n| n.len() == 1 && n.as_bytes()[0].is_ascii_digit());
    let device = matches!(stem.as_str(), "CON" | "PRN" | "AUX" | "NUL") || numbered("COM") || numbered("LPT");
    if device { format!("_{safe}") } else { safe.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_get_numbers() {
        let mut names = Names::default();
        let got: Vec<_> = ["Foot", "foot", "Foot_2", "Foot"].map(|n| names.unique(n)).into();
        assert_eq!(got, ["Foot", "foot_2", "Foot_2_2", "Foot_3"]);
    }

    #[test]
    fn names_cannot_leave_their_folder() {
        assert_eq!(file_name("../../a b/c", "mesh"), "_.._a b_c");
        assert_eq!(file_name(" ... ", "mesh"), "mesh");
        assert_eq!(file_name("nul.obj", "mesh"), "_nul.obj");
        assert_eq!(file_name("Foot.L", "mesh"), "Foot.L");
        assert!(file_name(&"ä".repeat(500), "mesh").len() <= LONGEST);
    }
}
