import {Rules} from './rules.mjs';
export const rules = new Rules('values');
export async function startRuntime() {}
