//! Principal strains, for files and pictures; stresses come from [`softrig::force::cell_stress`].

use softrig::force::polar::eigen_symmetric;
use softrig_linalg::Mat3;

/// Principal strains [-], largest first, of a strain tensor xx, yy, zz, xy, yz, zx.
#[must_use]
pub fn principal_strains(strain: &[f64; 6]) -> [f64; 3] {
    let [xx, yy, zz, xy, yz, zx] = *strain;
    let (mut values, _) = eigen_symmetric(Mat3([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]));
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Invariants of the tensor, and a shear that is known.
    #[test]
    fn principal_strains_have_the_invariants_of_the_tensor() {
        let e = [0.1, -0.2, 0.05, 0.03, -0.07, 0.11];
        let p = principal_strains(&e);
        assert!(p[0] >= p[1] && p[1] >= p[2]);
        let trace: f64 = p.iter().sum();
        let square: f64 = p.iter().map(|x| x * x).sum();
        let exact: f64 = e[..3].iter().map(|x| x * x).sum::<f64>() + 2.0 * e[3..].iter().map(|x| x * x).sum::<f64>();
        assert!((trace + 0.05).abs() < 1e-14 && (square - exact).abs() < 1e-14);
        let shear = principal_strains(&[0.0, 0.0, 0.0, 0.2, 0.0, 0.0]);
        assert!((shear[0] - 0.2).abs() < 1e-14 && (shear[2] + 0.2).abs() < 1e-14);
    }
}
