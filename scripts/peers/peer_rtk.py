"""RTK's Joseph forward projector on the CPU (package itk-rtk): interpolates bilinearly in the slices that a ray crosses."""
import os
import sys
from importlib import metadata

from worker import Refused, pooled, serve, timed

RAYS = (1, 2, 3)


def start(export, threads):
    os.environ["ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS"] = str(threads)
    import itk
    from itk import RTK as rtk

    itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(threads)
    export.check_upright()
    Image = itk.Image[itk.F, 3]
    volume = itk.imread(export.path, itk.F)
    volume.DisconnectPipeline()

    def typed(kind, values):
        made = kind()
        for axis, value in enumerate(values):
            made[axis] = float(value)
        return made

    point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    geometry = rtk.ThreeDCircularProjectionGeometry.New()
    # RTK's rows go up.
    added = geometry.AddProjection(
        typed(point, export.source), typed(point, export.centre), typed(vector, export.column), typed(vector, -export.row)
    )
    if not added:
        raise Refused("RTK cannot express this source and detector")

    def view(rays):
        size = [export.width * rays, export.height * rays]
        pitch = [p / rays for p in export.pitch]
        stack = rtk.ConstantImageSource[Image].New(Constant=0.0)
        stack.SetSize([*size, 1])
        stack.SetSpacing([*pitch, 1.0])
        stack.SetOrigin([-(size[0] - 1) / 2 * pitch[0], -(size[1] - 1) / 2 * pitch[1], 0.0])
        stack.Update()
        projector = rtk.JosephForwardProjectionImageFilter[Image, Image].New()
        projector.SetInput(0, stack.GetOutput())
        projector.SetInput(1, volume)
        projector.SetGeometry(geometry)
        projector.Update()
        rows = itk.array_view_from_image(projector.GetOutput())[0]
        return pooled(rows[::-1].astype("float64"), rays)

    return {
        "system": "RTK Joseph",
        "version": metadata.version("itk-rtk"),
        "field": "tent",
        "settings": [
            {"name": f"{rays}x{rays} rays", "rays": rays, "render": lambda rays=rays: timed(lambda: view(rays))} for rays in RAYS
        ],
    }


if __name__ == "__main__":
    sys.exit(serve(start))
