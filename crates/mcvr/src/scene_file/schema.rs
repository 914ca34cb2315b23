//! The JSON Schema of scene files, from the types that read them.

use mcvr_qmc::Scramble;
use mcvr_volume::{Endian, VoxelType};
use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, Transform};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use serde_json::Value;

use super::sections::order_names;
use super::{CameraSection, SceneFile};
use crate::Method;

/// The schema, in draft 7: the draft that TOML editors know.
pub(super) fn schema() -> Value {
    let mut schema = SchemaSettings::draft07().into_generator().into_root_schema_for::<SceneFile>();
    RecursiveTransform(without_null).transform(&mut schema);
    schema.insert("title".into(), "mcvr scene".into());
    schema.to_value()
}

/// TOML has no null: an absent key is absent.
fn without_null(schema: &mut Schema) {
    let Some(object) = schema.as_object_mut() else { return };
    if object.get("default") == Some(&Value::Null) {
        object.remove("default");
    }
    if let Some(Value::Array(types)) = object.get_mut("type") {
        types.retain(|t| t != "null");
        if let [one] = &types[..] {
            object["type"] = one.clone();
        }
    }
    if let Some(Value::Array(any)) = object.get_mut("anyOf") {
        any.retain(|s| s["type"] != "null");
        if any.len() == 1
            && let Some(Value::Object(only)) = any.pop()
        {
            object.remove("anyOf");
            // Draft 7 ignores everything beside a reference, so that stays wrapped.
            if only.contains_key("$ref") {
                object.insert("allOf".into(), Value::Array(vec![Value::Object(only)]));
            } else {
                object.extend(only);
            }
        }
    }
}

/// The names under which a type's values are written.
fn names<T: Serialize>(all: impl IntoIterator<Item = T>) -> Schema {
    let names: Vec<Value> = all.into_iter().filter_map(|v| serde_json::to_value(v).ok()).collect();
    json_schema!({ "type": "string", "enum": names })
}

pub(super) fn voxel_types(_: &mut SchemaGenerator) -> Schema {
    names(VoxelType::ALL)
}

pub(super) fn endians(_: &mut SchemaGenerator) -> Schema {
    names([Endian::Little, Endian::Big])
}

pub(super) fn methods(_: &mut SchemaGenerator) -> Schema {
    names(Method::ALL)
}

pub(super) fn orders(_: &mut SchemaGenerator) -> Schema {
    names(order_names().map(|(name, _)| name))
}

pub(super) fn scrambles(_: &mut SchemaGenerator) -> Schema {
    names(Scramble::ALL.map(|(_, s)| s))
}

pub(super) fn cameras(generator: &mut SchemaGenerator) -> Schema {
    let one = generator.subschema_for::<CameraSection>();
    let several = <Vec<CameraSection>>::json_schema(generator);
    json_schema!({ "anyOf": [one, several], "minItems": 1 })
}
