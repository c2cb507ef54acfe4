import * as GaussianSplats3D from "@mkkellogg/gaussian-splats-3d";
import * as THREE from "three";
import { placeThree, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
  renderer.setSize(canvas.width, canvas.height, false);
  const own = new THREE.PerspectiveCamera(50, canvas.width / canvas.height, 0.01, 1000);
  placeThree(own, camera);
  const viewer = new GaussianSplats3D.Viewer({
    renderer, camera: own, selfDrivenMode: false, useBuiltInControls: false, rootElement: canvas.parentElement,
    sharedMemoryForWorkers: false, sphericalHarmonicsDegree: 2, sceneRevealMode: GaussianSplats3D.SceneRevealMode.Instant,
  });
  await viewer.addSplatScene(src, { showLoadingUI: false });
  const frame = () => {
    requestAnimationFrame(frame);
    viewer.update();
    viewer.render();
    onFrame();
  };
  requestAnimationFrame(frame);
  const isSorted = () => viewer.splatRenderCount > 0 && !viewer.sortRunning;
  return { look: (next) => placeThree(own, next), isSorted };
}

window.bench = run({ open });
