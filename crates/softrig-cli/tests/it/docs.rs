//! The generated pages are those of this code.

use crate::root;

/// `UPDATE=1` writes them instead.
#[test]
fn generated_pages_are_current() {
    for (path, text) in softrig_cli::docs::pages() {
        let file = root().join(path);
        if std::env::var_os("UPDATE").is_some() {
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(&file, &text).unwrap();
        }
        let there = std::fs::read_to_string(&file).unwrap_or_default().replace("\r\n", "\n");
        assert!(there == text, "{path} is stale: UPDATE=1 cargo test --release -p softrig-cli docs");
    }
}
