// The way back over a tape: pullbacks of all steps, in the opposite order. `tape.h` says how a tape is laid out.

struct Pull { // cotangents; null where there are none
  const char *const *readings; // (steps, B, ...) each, as in `Rollout`
  const char *end;             // (blocks, record_bytes): moving states, readings, last outputs
  char *begin;                 // the same, found
  i64 record_bytes;
  char *fixed;   // (blocks, fixed_bytes) parameters and constant states, found
  char *actions; // (steps, B, M), found
};

template <class V> static void add_cells(char *to, i64 bytes, const i32 *cell, i64 count, const char *from) {
  i32 low, own[W];
  const i32 high = range(cell, own, low);
  VI place;
  memcpy(&place, own, sizeof place);
  for (i32 q = 0; q <= high; q++) {
    const VB here = eq(place, splat<VI>(q));
    char *at = to + (low + q) * bytes;
    for (i64 k = 0; any(here) && k < count; k++) st(at, k, ld<V>(at, k) + sel(here, ld<V>(from, k), splat<V>(0)));
  }
}
static void add_sized(char *to, i64 bytes, const i32 *cell, i64 count, i64 size, const char *from) {
  if (size == 4) add_cells<VF>(to, bytes, cell, count, from);
  else add_cells<VD>(to, bytes, cell, count, from);
}
// Bring cotangents that were added up beside the lanes' cells there.
static void spread(Run &r, i32 index) {
  const NodeInfo &n = r.m.node[index];
  int j = 0;
  for (const EdgeInfo *e = r.m.edge + n.first_edge; e < r.m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = r.m.node[e->sender];
    const Log &o = r.t.log[e->sender];
    for (i32 i = 0; i < e->window; i++, j++)
      if (r.bar_apart[j] && o.differs)
        add_sized(r.bars + o.bars, o.output_bytes, r.bar_cell[j], s.count, s.size, r.bar[j]);
  }
}

// Pull the cotangents of a step's results back to what it read. `SB`: of the node's state.
static void pull_back(Run &r, i32 index, const i32 *seq, const char *H, char *SB, char *EB, char *PB) {
  const NodeInfo &n = r.m.node[index];
  const Log &o = r.t.log[index];
  const i32 run = --r.runs[index];
  const char *state = r.state(o, run);
  char *bar = r.bar_of(o, o.depth + run); // 0 in lanes that did not run
  char new_bar[STATE * W];
  if (r.b.uniform) {
    char *to = BACK_STAGED[index] ? new_bar : SB;
    look_back(r, index, seq, true, true);
    BACKS[index](r.b.fixed, H, state, r.v.data, r.v.seq, r.v.times, nullptr, SB, bar, to, r.bar, nullptr, EB, PB,
                 r.m.constants);
    if (to != SB) memcpy(SB, new_bar, o.state_bytes);
    if (o.differs) memset(bar, 0, o.output_bytes); // for an earlier message
    return;
  }
  i32 runs[W], idle[W], place[W], some = 0;
  bool all = true;
  for (int l = 0; l < W; l++) some = seq[l] > some ? seq[l] : some;
  for (int l = 0; l < W; l++) {
    runs[l] = -(seq[l] >= 0);
    idle[l] = ~runs[l];
    all &= seq[l] >= 0;
    place[l] = seq[l] >= 0 ? seq[l] : some;
    r.next[index][l] += runs[l];
  }
  look_back(r, index, place, false, true);
  char state_bar[STATE * W];
  const char *from = SB;
  if (!all) { // no cotangent enters where the step did not run, and that of the state passes by
    const char zero[STATE * W] = {};
    memcpy(state_bar, SB, o.state_bytes);
    blend_state(n, state_bar, zero, idle);
    from = state_bar;
  }
  BACKS[index](r.b.fixed, H, state, r.v.data, r.v.seq, r.v.times, nullptr, from, bar, new_bar, r.bar, nullptr, EB, PB,
               r.m.constants);
  if (all) memcpy(SB, new_bar, o.state_bytes);
  else blend_state(n, SB, new_bar, runs);
  spread(r, index);
}

extern "C" void reverse(const Model *model, const char *fixed, const char *to, const Rollout *call, const Tape *tape,
                        const Pull *pull, char *bars) {
  const Model &m = *model;
  const Rollout &c = *call;
  const Tape &t = *tape;
  const Pull &p = *pull;
  const i32 supervisor = i32(m.supervisor);
  const NodeInfo &own = m.node[supervisor];
  const Log &kept = t.log[supervisor];
  const i64 times = t.starts ? 1 : c.steps, actions = t.starts ? 0 : c.steps;
  char H[HOISTED * W], reading_bar[READINGS * W];
  for (i64 block = c.first; block < c.last; block++) {
    const char *P = fixed + block * m.fixed_bytes;
    char *PB = p.fixed + block * m.fixed_bytes;
    char *record = p.begin + block * p.record_bytes; // holds the cotangents of the states as they go back
    i32 environment[W];
    memcpy(environment, P, sizeof environment);
    Block b = open_block(m, P, (char *)to + block * m.moving_bytes);
    Run r = open_run(m, t, b, block, bars);
    char EB[EARLY * W] = {};
    memset(PB, 0, m.fixed_bytes);
    if (p.end) memcpy(record, p.end + block * p.record_bytes, p.record_bytes);
    else memset(record, 0, p.record_bytes);
    prologue(P, H);
    memcpy(r.runs, t.runs + block * NODES, sizeof r.runs);
    for (i32 n = 0; n < NODES; n++) {
      const Log &o = t.log[n];
      memcpy(r.next[n], r.done_of(NODES + n), sizeof r.next[n]);
      if (!o.differs) continue;
      const i64 cells = o.depth + (n == supervisor ? actions : r.runs[n]);
      memset(bars + o.bars, 0, (b.uniform ? o.mask + 1 : cells) * o.output_bytes);
      for (i32 k = 0; k < o.depth; k++) {
        i32 cell[W], target[W];
        last_cells(r, n, k, cell, target);
        const char *last = record + o.history + k * o.output_bytes;
        const i64 count = m.node[n].count, size = m.node[n].size;
        if (b.uniform) memcpy(r.bar_of(o, cell[0]), last, o.output_bytes);
        else add_sized(r.bars + o.bars, o.output_bytes, cell, count, size, last);
      }
    }
    memcpy(reading_bar, record + m.readings, sizeof reading_bar);
    memset(record + m.readings, 0, sizeof reading_bar); // nothing depends on the readings before
    for (i64 time = times - 1; time >= 0; time--) {
      if (OBSERVES) {
        if (time < times - 1) memset(reading_bar, 0, sizeof reading_bar);
        for (i64 k = 0; k < c.outputs; k++) {
          if (!p.readings[k]) continue;
          char lanes[READINGS * W];
          i32 none[W] = {};
          const i64 count = c.reading_count[k], size = c.reading_size[k];
          gather(environment, p.readings[k] + time * m.batch * count * size, count * size, count, size, lanes);
          add_sized(reading_bar + c.reading_offset[k] * W, 0, none, count, size, lanes);
        }
        look_back(r, supervisor, b.step, b.uniform, true);
        char new_bar[STATE * W];
        char *SB = record + own.state, *to_bar = BACK_STAGED[supervisor] ? new_bar : SB;
        const i64 before = action_cell(r);
        BACKS[supervisor](P, H, r.state(kept, time), r.v.data, r.v.seq, r.v.times, r.output(kept, before), SB,
                          reading_bar, to_bar, r.bar, r.bar_of(kept, before), EB, PB, m.constants);
        if (to_bar != SB) memcpy(SB, new_bar, kept.state_bytes);
        if (!b.uniform) spread(r, supervisor);
      }
      i32 seq[W];
      for (i64 s = m.slots - 1; s >= 0; s--)
        if (steps_of_slot(r, s, seq)) pull_back(r, m.slot[s], seq, H, record + m.node[m.slot[s]].state, EB, PB);
      if (t.starts) continue;
      char *action_bar = r.bar_of(kept, kept.depth + time);
      if (p.actions)
        scatter(environment, action_bar, own.count, own.size, p.actions + time * m.batch * own.count * own.size);
      if (kept.differs) memset(action_bar, 0, kept.output_bytes);
      for (int l = 0; l < W; l++) b.step[l]--;
    }
    prologue_back(P, EB, PB, m.constants);
    for (i32 n = 0; n < NODES; n++) {
      const Log &o = t.log[n];
      for (i32 k = 0; k < o.depth && o.differs; k++)
        memcpy(record + o.history + k * o.output_bytes, r.bar_of(o, k), o.output_bytes);
    }
  }
}
