"""VTK's two volume mappers without a GPU (package vtk): the fixed-point CPU ray caster, and the "GPU" mapper on Mesa's llvmpipe.

The fixed-point mapper composites: opacity 1 - exp(-k w) per mm gives the pixel 1 - exp(-k line integral), which is turned back.
It is eight bits a pixel, so that its error has a floor. The GPU mapper adds up (additive blending); its image is rendered into
a texture of 32-bit floats, which spares it that floor. Choose one with VTK_MAPPER=fixed or gpu.
"""
import math
import os
import sys

import numpy as np

from worker import Refused, pooled, serve, timed

# Sample distance in units of the smallest spacing, and pixels along the side of the square that one ray serves.
FIXED = ((2.0, 2), (2.0, 1), (1.0, 2), (1.0, 1), (0.5, 1))
# The same sample distance, and rays along a pixel's side.
GPU = ((4.0, 1), (2.0, 1), (1.0, 1), (0.5, 1), (1.0, 2), (1.0, 3))


def start(export, threads):
    os.environ["LP_NUM_THREADS"] = str(threads)
    import vtk
    from vtk.util import numpy_support

    vtk.vtkMultiThreader.SetGlobalMaximumNumberOfThreads(threads)
    vtk.vtkSMPTools.Initialize(threads)
    export.check_axes("the VTK mapper")
    export.check_upright()
    export.check_centred("the VTK camera")
    if abs(export.pitch[0] / export.pitch[1] - 1) > 1e-9:
        raise Refused("the VTK camera has square pixels, and these are oblong")
    reader = vtk.vtkMetaImageReader()
    reader.SetFileName(export.path)
    reader.Update()
    volume = reader.GetOutput()
    smallest = min(export.spacing)
    largest = volume.GetScalarRange()[1]
    brightest = float(export.image("centre-tent").max())

    def scene(mapper, opacities, rays):
        looks = vtk.vtkVolumeProperty()
        looks.SetInterpolationTypeToLinear()
        looks.ShadeOff()
        opacity = vtk.vtkPiecewiseFunction()
        for at, value in opacities:
            opacity.AddPoint(at, value)
        white = vtk.vtkColorTransferFunction()
        white.AddRGBPoint(0, 1, 1, 1)
        white.AddRGBPoint(largest, 1, 1, 1)
        looks.SetScalarOpacity(opacity)
        looks.SetColor(white)
        looks.SetScalarOpacityUnitDistance(1.0)
        actor = vtk.vtkVolume()
        actor.SetMapper(mapper)
        actor.SetProperty(looks)
        renderer = vtk.vtkRenderer()
        renderer.SetBackground(0, 0, 0)
        renderer.AddVolume(actor)
        window = vtk.vtkRenderWindow()
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(export.width * rays, export.height * rays)
        window.AddRenderer(renderer)
        camera = renderer.GetActiveCamera()
        camera.SetPosition(*export.source)
        camera.SetFocalPoint(*(export.source - export.normal))
        camera.SetViewUp(*(-export.row))
        # The angle is that across the image's height.
        camera.SetViewAngle(2 * math.degrees(math.atan(export.height * export.pitch[1] / 2 / export.source_detector)))
        camera.SetClippingRange(1e-3 * export.source_centre, 2 * export.source_detector)
        return window, renderer

    def again(renderer):
        """Makes the next frame be rendered although nothing changed."""
        renderer.GetActiveCamera().Modified()

    def fixed(step, spread):
        # Transmission from 1 down to exp(-2) uses most of the eight bits.
        scale = 2.0 / brightest
        mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        mapper.SetInputData(volume)
        mapper.SetNumberOfThreads(threads)
        mapper.SetBlendModeToComposite()
        mapper.AutoAdjustSampleDistancesOff()
        mapper.LockSampleDistanceToInputSpacingOff()
        mapper.SetSampleDistance(step * smallest)
        mapper.SetInteractiveSampleDistance(step * smallest)
        mapper.SetImageSampleDistance(spread)
        opacities = [(w, 1 - math.exp(-scale * w)) for w in np.linspace(0, largest, 1024)]
        window, renderer = scene(mapper, opacities, 1)

        def view():
            again(renderer)
            mapper.Modified()
            window.Render()
            grab = vtk.vtkWindowToImageFilter()
            grab.SetInput(window)
            grab.SetInputBufferTypeToRGB()
            grab.ReadFrontBufferOff()
            grab.ShouldRerenderOff()
            grab.Update()
            levels = numpy_support.vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
            levels = levels.reshape(export.height, export.width, -1)[::-1, :, 0] / 255.0
            return -np.log(np.maximum(1 - levels, 1 / 512)) / scale

        return view

    def gpu(step, rays):
        mapper = vtk.vtkOpenGLGPUVolumeRayCastMapper()
        mapper.SetInputData(volume)
        mapper.SetBlendModeToAdditive()
        mapper.AutoAdjustSampleDistancesOff()
        mapper.LockSampleDistanceToInputSpacingOff()
        mapper.SetSampleDistance(step * smallest)
        mapper.UseJitteringOff()
        mapper.SetMaxMemoryInBytes(16 << 30)
        mapper.SetMaxMemoryFraction(1.0)
        # Opacity per mm at which the brightest pixel stays below 1.
        opacity = 0.95 * largest / brightest
        window, renderer = scene(mapper, [(0, opacity), (largest, opacity)], rays)
        steps = vtk.vtkRenderStepsPass()
        floats = vtk.vtkFramebufferPass()
        floats.SetDelegatePass(steps)
        floats.SetColorFormat(vtk.vtkTextureObject.Float32)
        # With any other depth format the mapper sees nothing.
        floats.SetDepthFormat(vtk.vtkTextureObject.Fixed32)
        renderer.SetPass(floats)
        width, height = export.width * rays, export.height * rays

        def view():
            again(renderer)
            window.Render()
            texture = floats.GetColorTexture()
            channels = texture.GetComponents()
            values = np.empty((height, width, channels), np.float32)
            buffer = texture.Download()
            buffer.Download2D(vtk.VTK_FLOAT, values, [width, height], channels, [0, 0])
            return pooled(values[::-1, :, 0].astype(np.float64) / opacity * largest, rays)

        return view

    built = {}

    def setting(name, make, **words):
        def render():
            if name not in built:
                # One scene at a time: each holds a copy of the volume.
                built.clear()
                built[name] = make()
                built[name]()
            return timed(built[name])

        return {"name": name, "render": render, **words}

    if os.environ.get("VTK_MAPPER", "fixed") == "fixed":
        system, settings = "VTK fixed point", [
            setting(f"step {s:g}, a ray for {i}x{i} pixels", lambda s=s, i=i: fixed(s, i), rays=1) for s, i in FIXED
        ]
    else:
        system, settings = "VTK on llvmpipe", [
            setting(f"step {s:g}, {r}x{r} rays", lambda s=s, r=r: gpu(s, r), rays=r) for s, r in GPU
        ]
    return {"system": system, "version": vtk.vtkVersion.GetVTKVersion(), "field": "tent", "settings": settings}


if __name__ == "__main__":
    sys.exit(serve(start))
