"""Type aliases of wgpu objects; wgpu is imported only when a device is opened."""

__all__ = [
    "BindGroup",
    "BindGroupLayout",
    "Buffer",
    "ComputePipeline",
    "Encoder",
    "PassTimestamps",
    "Promise",
    "RawDevice",
    "RenderPass",
    "RenderPipeline",
    "Resource",
    "ShaderModule",
    "Texture",
    "TextureView",
]

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from wgpu import GPUBindGroup as BindGroup
    from wgpu import GPUBindGroupLayout as BindGroupLayout
    from wgpu import GPUBuffer as Buffer
    from wgpu import GPUCommandEncoder as Encoder
    from wgpu import GPUComputePipeline as ComputePipeline
    from wgpu import GPUDevice as RawDevice
    from wgpu import GPUPromise as Promise
    from wgpu import GPURenderPassEncoder as RenderPass
    from wgpu import GPURenderPipeline as RenderPipeline
    from wgpu import GPUShaderModule as ShaderModule
    from wgpu import GPUTexture as Texture
    from wgpu import GPUTextureView as TextureView
else:
    BindGroup = BindGroupLayout = Buffer = ComputePipeline = Encoder = Promise = object
    RawDevice = RenderPass = RenderPipeline = ShaderModule = Texture = TextureView = object

Resource: TypeAlias = Buffer | tuple[Buffer, int, int]
"""A resource that a kernel binds: a buffer, or a buffer with an offset and a size in bytes."""

PassTimestamps: TypeAlias = dict[str, object]
"""The ``timestamp_writes`` of a wgpu pass: a query set and two indices."""
