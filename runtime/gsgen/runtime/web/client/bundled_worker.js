/** The worker that reads files, for bundlers: in one file with all readers, which else load when a file needs them. */

import * as findings from "./findings.js";
import * as fzstd from "./fzstd.js";
import * as glb from "./glb.js";
import * as ply from "./ply.js";
import * as pointCloud from "./point_cloud.js";
import * as sog from "./sog.js";
import * as spz from "./spz.js";
import * as zip from "./zip.js";
import "./reader_worker.js";

// A bundle has what is used at once; Vite packs workers that load more only when told to.
Object.assign(self, { modules: [findings, fzstd, glb, ply, pointCloud, sog, spz, zip] });
