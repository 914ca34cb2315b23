//! Pictures of several methods beside the truth. Here all stand side by side; the page's script makes one view with
//! controls of them, from the same embedded data.

use std::path::Path;

use super::embed::picture;
use super::escape;
use crate::HarnessError;
use crate::report::Viewer;

/// The pictures as figures that say what they are; those not in the folder are left out.
///
/// # Errors
/// [`HarnessError::File`] when a picture is there but cannot be read.
pub(super) fn html(viewer: &Viewer, folder: &Path) -> Result<String, HarnessError> {
    let truth = picture(&folder.join(&viewer.truth.0), &viewer.truth.1, " data-role=\"truth\"")?.unwrap_or_default();
    let mut text = format!(
        "<div class=\"viewer\" data-setting=\"{}\">\n<div class=\"gallery\">\n<div class=\"pictures\">\n{truth}</div>\n",
        escape(&viewer.setting)
    );
    for series in &viewer.series {
        let label = escape(&series.label);
        text.push_str(&format!("<div class=\"series\" data-label=\"{label}\">\n<h3>{label}</h3>\n"));
        for role in ["image", "difference"] {
            text.push_str("<div class=\"pictures\">\n");
            for shot in &series.shots {
                let (name, what) = match role {
                    "image" => (&shot.image, shot.caption.clone()),
                    _ => (&shot.difference, format!("{}, difference", shot.caption)),
                };
                let marks = format!(" data-role=\"{role}\" data-setting=\"{}\"", shot.setting);
                text.push_str(&picture(&folder.join(name), &what, &marks)?.unwrap_or_default());
            }
            text.push_str("</div>\n");
        }
        text.push_str("</div>\n");
    }
    text.push_str("</div>\n</div>\n");
    Ok(text)
}
