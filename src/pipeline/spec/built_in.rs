//! The pipelines in the program: the files of `pipelines/`, by their names.

/// A pipeline in the program.
#[derive(Debug, PartialEq, Eq)]
pub struct BuiltIn {
    /// Name: that of its file, without extension.
    pub name: &'static str,
    /// Text of its file.
    pub text: &'static str,
}

macro_rules! built_in {
    ($($name:literal),* $(,)?) => {
        /// All pipelines in the program: first the one that runs by default, then the others by their names.
        pub const BUILT_IN: &[BuiltIn] = &[$(BuiltIn {
            name: $name,
            text: include_str!(concat!("../../../pipelines/", $name, ".toml")),
        }),*];
    };
}

built_in!(
    "scene",
    "all-visible",
    "around-the-corner",
    "average",
    "barcode",
    "barcode-blocked",
    "characterize",
    "faint",
    "hidden-plane",
    "inter-reflections",
    "mirror",
    "relay-wall",
    "separate",
    "tdr",
    "visible",
);

/// Name of the pipeline that runs unless the user names another.
pub const DEFAULT: &str = "scene";

impl BuiltIn {
    /// The pipeline of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        BUILT_IN.iter().find(|pipeline| pipeline.name == name)
    }

    /// The scene that it is for: the first line of its text, a sentence.
    #[must_use]
    pub fn purpose(&self) -> &'static str {
        self.text.lines().next().unwrap_or_default().trim_start_matches(['#', ' '])
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::super::Spec;
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_in_the_program() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines");
        let files = std::fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.path());
        let files = files.filter(|file| file.extension().is_some_and(|extension| extension == "toml"));
        let files: BTreeSet<String> =
            files.map(|file| file.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
        let names: BTreeSet<String> = BUILT_IN.iter().map(|pipeline| pipeline.name.to_owned()).collect();
        assert_eq!(names, files, "src/pipeline/spec/built_in.rs lists the files of pipelines/");
        assert!(BUILT_IN[1..].is_sorted_by_key(|pipeline| pipeline.name));
        assert_eq!(BUILT_IN[0].name, DEFAULT);
    }

    #[test]
    fn every_pipeline_begins_with_its_purpose_and_is_accepted() {
        for pipeline in BUILT_IN {
            let purpose = pipeline.purpose();
            assert!(pipeline.text.starts_with("# "), "{}: the first line is a comment", pipeline.name);
            assert!(purpose.len() <= 100, "{}: {purpose}", pipeline.name);
            assert!(purpose.ends_with('.') && !purpose.trim_end_matches('.').contains(". "), "{purpose}");
            let spec = Spec::load(Path::new(pipeline.name), &[]);
            assert!(spec.is_ok(), "{}: {}", pipeline.name, spec.err().unwrap());
        }
    }
}
