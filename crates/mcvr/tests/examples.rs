//! The example scenes: each is described by the schema, reads, and renders.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::path::{Path, PathBuf};
use std::process::Command;

use mcvr::SceneFile;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

fn examples() -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder())
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "toml"))
        .collect();
    all.sort();
    assert!(all.len() >= 11, "{all:?}");
    all
}

/// Every key of a TOML value has a place in the schema, under any of its alternatives.
fn described(value: &toml::Value, schema: &serde_json::Value, root: &serde_json::Value) -> bool {
    if let Some(name) = schema["$ref"].as_str() {
        return described(value, root.pointer(name.trim_start_matches('#')).expect(name), root);
    }
    for alternatives in ["anyOf", "oneOf", "allOf"] {
        if let Some(all) = schema[alternatives].as_array() {
            return all.iter().any(|s| described(value, s, root));
        }
    }
    let names = schema["enum"].as_array();
    match value {
        toml::Value::Table(table) => {
            schema["type"] == "object"
                && table.iter().all(|(k, v)| schema["properties"].get(k).is_some_and(|s| described(v, s, root)))
        }
        toml::Value::Array(items) => {
            schema["type"] == "array"
                && match &schema["items"] {
                    serde_json::Value::Array(each) => items.iter().zip(each).all(|(v, s)| described(v, s, root)),
                    one => items.iter().all(|v| described(v, one, root)),
                }
        }
        toml::Value::String(s) => {
            schema["type"] == "string"
                && names.is_none_or(|n| n.iter().any(|n| n == s))
                && schema.get("const").is_none_or(|c| c == s)
        }
        toml::Value::Integer(_) => schema["type"] == "integer" || schema["type"] == "number",
        toml::Value::Float(_) => schema["type"] == "number",
        toml::Value::Boolean(_) => schema["type"] == "boolean",
        toml::Value::Datetime(_) => false,
    }
}

#[test]
fn the_committed_schema_is_the_generated_one() {
    let path = folder().join("scene.schema.json");
    let committed: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    assert!(committed == SceneFile::schema(), "run: mcvr schema > examples/scene.schema.json");
    let printed = Command::new(env!("CARGO_BIN_EXE_mcvr")).arg("schema").output().unwrap();
    assert_eq!(String::from_utf8(printed.stdout).unwrap(), std::fs::read_to_string(&path).unwrap());
}

#[test]
fn the_schema_knows_nothing_of_null_and_describes_every_key() {
    fn walk(schema: &serde_json::Value, path: &str) {
        match schema {
            serde_json::Value::Object(object) => {
                assert!(object.get("type") != Some(&"null".into()), "{path}");
                if let Some(properties) = object.get("properties").and_then(|p| p.as_object()) {
                    assert_eq!(object["additionalProperties"], false, "{path}");
                    // The one key of an enum's variant is described beside the variant.
                    let variant = properties.len() == 1 && object.contains_key("description");
                    for (key, value) in properties {
                        let text = value.to_string();
                        let described = text.contains("description") || text.contains("$ref");
                        assert!(described || variant, "{path}.{key}: {text}");
                    }
                }
                object.iter().for_each(|(k, v)| walk(v, &format!("{path}.{k}")));
            }
            serde_json::Value::Array(all) => all.iter().for_each(|v| walk(v, path)),
            _ => assert!(!schema.is_null(), "{path}"),
        }
    }
    walk(&SceneFile::schema(), "");
}

#[test]
fn every_example_reads_and_is_described_by_the_schema() {
    let schema = SceneFile::schema();
    for path in examples() {
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("#:schema scene.schema.json\n"), "{}", path.display());
        let scene = SceneFile::read(&path).unwrap_or_else(|e| panic!("{e}"));
        assert!(scene.volume.input.unwrap().starts_with("phantom:"), "{}: runs anywhere", path.display());
        let value: toml::Value = toml::from_str(&text).unwrap();
        assert!(described(&value, &schema, &schema), "{}", path.display());
    }
    let wrong: toml::Value = toml::from_str("[image]\nkernel = \"tant\"\n").unwrap();
    assert!(!described(&wrong, &schema, &schema), "the test can fail");
}

#[test]
fn every_example_renders() {
    let out = tempfile::tempdir().unwrap();
    for path in examples() {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let run = Command::new(env!("CARGO_BIN_EXE_mcvr"))
            .args(["render", "--samples", "2^12", "--size", "64x64", "--json", "-", "--scene"])
            .args([path.as_os_str(), "-o".as_ref(), out.path().join(format!("{name}.png")).as_os_str()])
            .output()
            .unwrap();
        assert!(run.status.success(), "{name}: {}", String::from_utf8_lossy(&run.stderr));
        let record: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
        let cameras = SceneFile::read(&path).unwrap().cameras;
        let images = match cameras.len() {
            0 | 1 => vec![format!("{name}.png")],
            _ => cameras.iter().enumerate().map(|(i, c)| format!("{name}-{}.png", c.label(i))).collect(),
        };
        for image in images {
            let size = out.path().join(&image).metadata().unwrap_or_else(|e| panic!("{image}: {e}")).len();
            assert!(size > 100, "{image}: {size} bytes");
        }
        let counters = match cameras.len() {
            0 | 1 => &record["counters"]["render"],
            _ => &record["images"][0]["counters"]["render"],
        };
        assert!(counters["inside"].as_u64().unwrap() > 100, "{name}: samples reach the image: {counters}");
    }
}
