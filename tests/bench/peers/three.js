import * as THREE from "three/webgpu";
import { GaussianSplatPLYLoader } from "three/addons/loaders/GaussianSplatPLYLoader.js";
import { GaussianSplat } from "three/addons/objects/GaussianSplat.js";
import { placeThree, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const renderer = new THREE.WebGPURenderer({ canvas, forceWebGL: true });
  renderer.setSize(canvas.width, canvas.height, false);
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // colours of Gaussians are sRGB already
  renderer.setClearColor(0x000000, 1);
  await renderer.init();
  const scene = new THREE.Scene();
  const own = new THREE.PerspectiveCamera(50, canvas.width / canvas.height, 0.01, 1000);
  placeThree(own, camera);
  const splats = new GaussianSplat(await new GaussianSplatPLYLoader().loadAsync(src));
  scene.add(splats);
  renderer.setAnimationLoop(() => {
    renderer.render(scene, own);
    onFrame();
  });
  return { look: (next) => placeThree(own, next), isSorted: () => true };
}

window.bench = run({ open });
