import { FreeCamera } from "@babylonjs/core/Cameras/freeCamera.js";
import { Engine } from "@babylonjs/core/Engines/engine.js";
import { Color4 } from "@babylonjs/core/Maths/math.color.js";
import { Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { GaussianSplattingMesh } from "@babylonjs/core/Meshes/GaussianSplatting/gaussianSplattingMesh.js";
import { Scene } from "@babylonjs/core/scene.js";
import { fieldOfView, placeOf, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const engine = new Engine(canvas, false);
  const scene = new Scene(engine);
  scene.useRightHandedSystem = true;
  scene.clearColor = new Color4(0, 0, 0, 1);
  const own = new FreeCamera("camera", Vector3.Zero(), scene);
  own.minZ = 0.01;
  const look = (next) => {
    const { eye, target, up } = placeOf(next);
    own.fov = (fieldOfView(next) * Math.PI) / 180;
    own.position = Vector3.FromArray(eye);
    own.upVector = Vector3.FromArray(up);
    own.setTarget(Vector3.FromArray(target));
  };
  look(camera);
  const splats = new GaussianSplattingMesh("splats", null, scene);
  const data = await (await fetch(src)).arrayBuffer();
  const { buffer, sh, shDegree } = await GaussianSplattingMesh.ConvertPLYWithSHToSplatAsync(data);
  await splats.updateDataAsync(buffer, sh ?? undefined, undefined, shDegree);
  engine.runRenderLoop(() => {
    scene.render();
    onFrame();
  });
  return { look, isSorted: () => splats.isReady(true) };
}

window.bench = run({ open });
