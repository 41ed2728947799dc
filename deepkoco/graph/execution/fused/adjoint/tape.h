// Rollouts that leave a tape. What runs when is the same as in `driver.h`.
//
// In place of the last state and the last few outputs, the tape of a block keeps all of them. A node's run c, in some or
// all lanes, reads cell c of its states and writes the next one; lanes that do not run copy what they had. Its output
// lies in cell depth + c, behind those from before the rollout; where it is a part of the new state, it lies there and
// is not kept twice. A lane may have made its message k in a later run than another lane its own: `map` says in which.
//
// On the way back, cotangents of messages are added up in cells of their own. If all lanes have the same schedule, a
// message is no longer looked at once `depth` later ones are there, so a few cells are enough.

struct Log { // of a node
  i64 first, states;         // where the first state lies in a block's tape, and where the cells of all begin [bytes]
  i64 state_bytes;           // of one
  i64 outputs, output_bytes; // where the cells of its outputs begin; bytes of one
  i64 stride;                // from one to the next
  i64 map;                   // (messages, W) i32, in which run a lane has made each
  i64 bars;                  // where the cotangents of its outputs begin in a block's scratch [bytes]
  i64 history;               // and those of its outputs before the rollout, in the record of cotangents [bytes]
  i32 depth, differs;        // outputs before the rollout; whether outputs are floating-point numbers
  i32 mask, unused;          // cells of cotangents - 1 of a block with one schedule
};
struct Tape {
  const Log *log;
  const i32 *done; // (2 * nodes, blocks * W) steps that had run before the rollout, then those that it runs
  i32 *runs;       // (blocks, nodes) how often each node has run in some or all lanes
  char *memory;    // (blocks, block_bytes)
  i64 block_bytes;
  i64 starts; // whether this is the way from a reset to the first action
};

struct Run {
  const Model &m;
  const Tape &t;
  Block &b;
  char *log, *bars; // tape and cotangents of this block
  const i32 *done;  // of node 0; those of the next one lie m.blocks * W further
  i32 runs[NODES];    // so far
  i32 next[NODES][W]; // messages of this rollout that each lane has made, in blocks of several schedules
  View v;
  char *bar[PLACES];       // cotangents of what a node sees
  i32 bar_cell[PLACES][W]; // and where the lanes find them, if not all in one cell
  bool bar_apart[PLACES];
  char bar_stage[STAGE * W];

  const i32 *done_of(i32 n) const { return done + i64(n) * m.blocks * W; }
  const char *state(const Log &o, i32 run) const { return log + (run ? o.states + run * o.state_bytes : o.first); }
  char *after(const Log &o, i32 run) const { return log + o.states + (run + 1) * o.state_bytes; }
  char *output(const Log &o, i64 cell) const { return log + o.outputs + cell * o.stride; }
  char *bar_of(const Log &o, i64 cell) const {
    return bars + o.bars + (b.uniform ? cell & o.mask : cell) * o.output_bytes;
  }
  // Where a lane finds a message.
  i32 cell(i32 sender, int lane, i32 message) const {
    const Log &o = t.log[sender];
    const i32 k = message - done_of(sender)[lane];
    // Of the initial output there may be fewer than places in the window.
    if (k < 0) return k + o.depth < 0 ? 0 : k + o.depth;
    if (b.uniform || sender == m.supervisor) return o.depth + k;
    if (k >= next[sender][lane]) return 0; // a lane that only looks where others do
    return o.depth + ((const i32 *)(log + o.map))[k * W + lane];
  }
};

INLINE bool level(const i32 *cell) {
  for (int l = 1; l < W; l++)
    if (cell[l] != cell[0]) return false;
  return true;
}
INLINE i32 range(const i32 *cell, i32 *relative, i32 &low) { // largest of the cells, counted from the lowest
  i32 high = low = cell[0];
  for (int l = 1; l < W; l++) low = cell[l] < low ? cell[l] : low, high = cell[l] > high ? cell[l] : high;
  for (int l = 0; l < W; l++) relative[l] = cell[l] - low;
  return high - low;
}
// Each lane's own cell.
static void pick_cells(const char *from, i64 bytes, const i32 *cell, i64 count, i64 size, char *out) {
  i32 low, own[W];
  const i32 high = range(cell, own, low);
  pick(from + low * bytes, bytes, high, own, count, size, out);
}
static void put_cells(char *to, i64 bytes, const i32 *cell, i64 count, i64 size, const char *from) {
  for (int l = 0; l < W; l++)
    for (i64 k = 0; k < count; k++)
      memcpy(to + cell[l] * bytes + (k * W + l) * size, from + (k * W + l) * size, size);
}
// Take a state from another one in some lanes: its elements of 8, 4 and 1 byte.
static void blend_state(const NodeInfo &n, char *to, const char *from, const i32 *where) {
  blend_sized(to, from, n.n8, 8, where);
  to += 8 * n.n8 * W, from += 8 * n.n8 * W;
  blend_sized(to, from, n.n4, 4, where);
  to += 4 * n.n4 * W, from += 4 * n.n4 * W;
  if (n.n1) blend_bytes(to, from, n.n1, 1, where);
}

// Collect what node `index` sees at the steps `seq` of the lanes, and where its cotangents go if `back`.
static void look_back(Run &r, i32 index, const i32 *seq, bool together, bool back) {
  const Model &m = r.m;
  const NodeInfo &n = m.node[index];
  char *stage = r.v.stage, *bar_stage = r.bar_stage;
  const int lanes = together ? 1 : W;
  int j = 0;
  for (int l = 0; n.flags & 1 && l < lanes; l++) {
    const double start = seconds(m.t_start[r.b.row[l] * m.step_columns + n.step_base + seq[l]], m);
    if (together) r.v.times[0] = splat<VD>(start);
    else put(r.v.times[0], l, start);
  }
  for (const EdgeInfo *e = m.edge + n.first_edge; e < m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = m.node[e->sender];
    const Log &o = r.t.log[e->sender];
    for (i32 i = 0; i < e->window; i++, j++) {
      i32 message[W], *cell = r.bar_cell[j];
      for (int l = 0; l < lanes; l++) {
        message[l] = m.windows[r.b.row[l] * m.window_columns + e->window_base + i64(seq[l]) * e->window + i];
        cell[l] = r.cell(e->sender, l, message[l]);
      }
      const bool same = together || level(cell);
      r.v.data[j] = r.output(o, cell[0]);
      r.bar[j] = r.bar_of(o, cell[0]);
      r.bar_apart[j] = !same;
      if (!same) {
        pick_cells(r.output(o, 0), o.stride, cell, s.count, s.size, stage);
        r.v.data[j] = stage;
        stage += o.output_bytes;
        if (back) {
          memset(bar_stage, 0, o.output_bytes);
          r.bar[j] = bar_stage;
          bar_stage += o.output_bytes;
        }
      }
      for (int l = 0; l < lanes && e->flags; l++) {
        double sent, received;
        times_of(m, *e, r.b.row[l], message[l], sent, received);
        if (together) {
          r.v.seq[j] = splat<VL>(i64(message[l]));
          r.v.times[1 + j] = splat<VD>(sent);
          r.v.times[1 + PLACES + j] = splat<VD>(received);
          continue;
        }
        put(r.v.seq[j], l, message[l]);
        put(r.v.times[1 + j], l, sent);
        put(r.v.times[1 + PLACES + j], l, received);
      }
    }
  }
}
// Run step `seq` of a node (-1: not in this lane) and keep what was before.
static void run_kept(Run &r, i32 index, const i32 *seq, const char *H) {
  const NodeInfo &n = r.m.node[index];
  const Log &o = r.t.log[index];
  const i32 run = r.runs[index]++;
  const char *state = r.state(o, run);
  char *after = r.after(o, run), *output = r.output(o, o.depth + run);
  if (r.b.uniform) {
    look_back(r, index, seq, true, false);
    BODIES[index](r.b.fixed, H, state, r.v.data, r.v.seq, r.v.times, nullptr, after, output, r.m.constants);
    return;
  }
  i32 idle[W], place[W], some = 0, *map = (i32 *)(r.log + o.map);
  for (int l = 0; l < W; l++) some = seq[l] > some ? seq[l] : some;
  bool all = true;
  for (int l = 0; l < W; l++) {
    idle[l] = -(seq[l] < 0);
    all &= seq[l] >= 0;
    place[l] = seq[l] >= 0 ? seq[l] : some; // the others look where these do; it is not used
  }
  look_back(r, index, place, false, false);
  BODIES[index](r.b.fixed, H, state, r.v.data, r.v.seq, r.v.times, nullptr, after, output, r.m.constants);
  if (!all) blend_state(n, after, state, idle);
  for (int l = 0; l < W; l++)
    if (!idle[l]) map[r.next[index][l]++ * W + l] = run;
}

// Steps of node `n` that a slot runs now, -1 for none; returns whether any lane runs.
INLINE bool steps_of_slot(const Run &r, i64 slot, i32 *seq) {
  bool some = false;
  for (int l = 0; l < (r.b.uniform ? 1 : W); l++) {
    seq[l] = seq_at(r.m, r.b.row[l], r.b.step[l], slot);
    some |= seq[l] >= 0;
  }
  return some;
}
// Where the supervisor's outputs lie: the one before the step that each lane is at.
INLINE i64 action_cell(const Run &r) {
  const i32 s = i32(r.m.supervisor);
  return i64(r.b.step[0]) - 1 - r.done_of(s)[0] + r.t.log[s].depth;
}

// Where the last messages after the rollout lie, the oldest first: on the tape and in the ring.
INLINE void last_cells(const Run &r, i32 n, i32 k, i32 *cell, i32 *target) {
  const i32 *made = r.done_of(NODES + n);
  for (int l = 0; l < W; l++) {
    const i32 message = r.done_of(n)[l] + made[l] - r.t.log[n].depth + k;
    cell[l] = r.cell(n, l, message);
    target[l] = message & r.m.node[n].ring_mask;
  }
}

static Run open_run(const Model &m, const Tape &t, Block &b, i64 block, char *bars) {
  Run r{m, t, b, t.memory + block * t.block_bytes, bars, t.done + block * W,
        {}, {}, {}, {}, {}, {}, {}};
  return r;
}

extern "C" i64 record(const Model *model, const char *fixed, const char *from, char *to, const Rollout *call,
                      const Tape *tape) {
  const Model &m = *model;
  const Rollout &c = *call;
  const Tape &t = *tape;
  const i64 spent = t.starts ? -1 : short_of_steps(m, fixed, from, c.first, c.last, c.steps);
  if (spent >= 0) return spent;
  const i32 supervisor = i32(m.supervisor);
  const NodeInfo &own = m.node[supervisor];
  const Log &kept = t.log[supervisor];
  char H[HOISTED * W];
  for (i64 block = c.first; block < c.last; block++) {
    const char *P = fixed + block * m.fixed_bytes;
    char *moving = to + block * m.moving_bytes;
    memcpy(moving, from + block * m.moving_bytes, m.moving_bytes);
    i32 environment[W];
    memcpy(environment, P, sizeof environment);
    Block b = open_block(m, P, moving);
    Run r = open_run(m, t, b, block, nullptr);
    prologue(P, H);
    for (i32 n = 0; n < NODES; n++) {
      const NodeInfo &node = m.node[n];
      const Log &o = t.log[n];
      memcpy(r.log + o.first, moving + node.state, o.state_bytes);
      for (i32 k = 0; k < o.depth; k++) {
        i32 cell[W];
        for (int l = 0; l < W; l++) cell[l] = (r.done_of(n)[l] - o.depth + k) & node.ring_mask;
        pick(moving + node.ring, o.output_bytes, node.ring_mask, cell, node.count, node.size, r.output(o, k));
      }
    }
    for (i64 time = 0; time < (t.starts ? 1 : c.steps); time++) {
      if (!t.starts) {
        char *action = r.output(kept, kept.depth + time);
        gather(environment, c.actions + time * c.action_time, c.action_environment, own.count, own.size, action);
        for (int l = 0; l < W; l++) b.step[l]++;
      }
      i32 seq[W];
      for (i64 s = 0; s < m.slots; s++)
        if (steps_of_slot(r, s, seq)) run_kept(r, m.slot[s], seq, H);
      if (!OBSERVES) continue;
      look_back(r, supervisor, b.step, b.uniform, false);
      BODIES[supervisor](P, H, r.state(kept, time), r.v.data, r.v.seq, r.v.times, r.output(kept, action_cell(r)),
                         r.after(kept, time), moving + m.readings, m.constants);
      r.runs[supervisor]++;
      for (i64 k = 0; k < c.outputs; k++)
        scatter(environment, moving + m.readings + c.reading_offset[k] * W, c.reading_count[k], c.reading_size[k],
                c.out_readings[k] + time * m.batch * c.reading_count[k] * c.reading_size[k]);
    }
    for (i32 n = 0; n < NODES; n++) {
      const NodeInfo &node = m.node[n];
      const Log &o = t.log[n];
      memcpy(moving + node.state, r.state(o, r.runs[n]), o.state_bytes);
      for (i32 k = 0; k < o.depth; k++) {
        i32 cell[W], target[W];
        last_cells(r, n, k, cell, target);
        char output[OUTPUT * W];
        const char *last = r.output(o, cell[0]);
        if (!level(cell)) {
          pick_cells(r.output(o, 0), o.stride, cell, node.count, node.size, output);
          last = output;
        }
        if (level(target)) memcpy(moving + node.ring + target[0] * o.output_bytes, last, o.output_bytes);
        else put_cells(moving + node.ring, o.output_bytes, target, node.count, node.size, last);
      }
    }
    memcpy(moving, b.step, sizeof b.step);
    memcpy(t.runs + block * NODES, r.runs, sizeof r.runs);
  }
  return -1;
}

