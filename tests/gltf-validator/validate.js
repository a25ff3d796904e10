// Prints what the Khronos validator says about each file; ends with 1 when any has errors.
const fs = require("fs");
const validator = require("gltf-validator");

async function main() {
  let errors = 0;
  for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { maxIssues: 20 });
    const { numErrors, numWarnings, numInfos, messages } = report.issues;
    console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos`);
    for (const m of messages.slice(0, 8)) console.log(`  ${m.code} ${m.pointer}: ${m.message}`);
    errors += numErrors;
  }
  process.exit(errors > 0 ? 1 : 0);
}

main();
