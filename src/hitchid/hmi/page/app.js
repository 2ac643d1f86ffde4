/** The page of `hitchid hmi`: put the parts together. */
import { bindAdaptation } from "./adaptation.js";
import { bindBench } from "./bench.js";
import { bindCampaign } from "./campaign.js";
import { Connection } from "./connection.js";
import { bindDrive } from "./drive.js";
import { bindHeader } from "./header.js";
import { bindIdentify } from "./identify.js";
import { Jobs } from "./jobs.js";
import { bindLive } from "./live.js";
import { MEASURED } from "./frames.js";
import { showProblems } from "./problems.js";
import { bindProject, Project } from "./project.js";
import { bindSections } from "./sections.js";
import { bindStop } from "./stop.js";

const connection = new Connection();
const project = new Project(connection);
const jobs = new Jobs(connection);

showProblems(connection);
bindStop(connection);
bindHeader(connection, project);
const plots = bindLive(connection);
bindBench(connection, project);
bindAdaptation(connection, project);
bindCampaign(connection, project, jobs);
bindIdentify(connection, project, jobs);
bindDrive(connection, project, jobs);
bindProject(connection, project);

/** What tests of the page read. */
const probe = {
  stats: plots.stats,
  samples: 0,
  plots,
  connection,
  get jobs() {
    return [...jobs.all.values()];
  },
};
connection.addEventListener("frame", ({ detail }) => {
  if (detail.kind === MEASURED) probe.samples += detail.rows;
});
/** @type {any} */ (window).hitchid = probe;

connection.open().then(bindSections);
