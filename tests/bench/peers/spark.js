import * as THREE from "three";
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import { placeThree, run } from "./page.js";

async function open(canvas, src, camera, onFrame) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
  renderer.setSize(canvas.width, canvas.height, false);
  const scene = new THREE.Scene();
  const own = new THREE.PerspectiveCamera(50, canvas.width / canvas.height, 0.01, 1000);
  placeThree(own, camera);
  const spark = new SparkRenderer({ renderer });
  scene.add(spark);
  const splats = new SplatMesh({ url: src });
  scene.add(splats);
  await splats.initialized;
  renderer.setAnimationLoop(() => {
    renderer.render(scene, own);
    onFrame();
  });
  const isSorted = () => spark.activeSplats > 0 && !spark.sorting && !spark.sortDirty;
  return { look: (next) => placeThree(own, next), isSorted };
}

window.bench = run({ open });
