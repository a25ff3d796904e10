#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_cli::scene::parse;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    match parse(text) {
        // journals remember their scene as text
        Ok(scene) => {
            let written = toml::to_string(&scene).expect("a scene is plain data");
            assert_eq!(parse(&written).expect("what was written is read"), scene);
        }
        Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
    }
});
