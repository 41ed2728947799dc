// What Python hands to a kernel, and what a kernel keeps while it runs; the same as in `kernel.py`.

struct NodeInfo {
  i64 state;         // offset in the moving record [bytes]
  i64 n8, n4, n1;    // elements of the state by size
  i64 ring;          // offset of its last outputs in the moving record [bytes]
  i64 count, size;   // elements of an output, bytes of one
  i64 step_base;     // column of its first step
  i32 ring_mask;     // cells of the ring - 1
  i32 first_edge, edges;
  i32 flags;         // 1: reads t_start, 2: its new state is staged
};
struct EdgeInfo {
  i64 window_base, message_base;
  i32 sender, window, flags, unused; // flags 1: reads seq, 2: t_sent, 4: t_received
};
struct Model {
  i64 slots, steps, small_table; // steps: of the supervisor; table of int16 or int32
  i64 supervisor, readings;      // its index; offset of the readings in the moving record [bytes]
  i64 fixed_bytes, moving_bytes, blocks, batch;
  i64 window_columns, step_columns, message_columns;
  double resolution;
  const NodeInfo *node;
  const EdgeInfo *edge;
  const i32 *slot;
  const void *table;
  const i32 *windows;
  const i64 *t_start, *t_end, *t_received;
  const char *constants;
};

struct View { // what a node sees
  const char *data[PLACES];
  VL seq[PLACES];
  VD times[1 + 2 * PLACES];
  char stage[STAGE * W];
};
struct Call { // what a body is given, for up to SIDE blocks
  const char *P[SIDE], *H[SIDE], *S[SIDE], *const *X[SIDE];
  const VL *Q[SIDE];
  const VD *T[SIDE];
  const char *A[SIDE];
  char *S2[SIDE], *Y[SIDE];
  i64 count; // the others repeat the first

  INLINE_MEMBER void set(i64 k, const char *p, const char *h, const char *s, const char *const *x, const View &v,
                         char *s2, char *y, const char *action = nullptr) {
    P[k] = p, H[k] = h, S[k] = s, X[k] = x, Q[k] = v.seq, T[k] = v.times, A[k] = action, S2[k] = s2, Y[k] = y;
  }
  INLINE_MEMBER void repeat(i64 k) {
    P[k] = *P, H[k] = *H, S[k] = *S, X[k] = *X, Q[k] = *Q, T[k] = *T, A[k] = *A, S2[k] = *S2, Y[k] = *Y;
  }
};
typedef void (*Policy)(const char *weights, const char *R, const char *const *X, const VL *Q, const VD *T, const char *G, char *Y);
typedef void (*Policies)(const char *weights, const char *const *R, const char *const *G, char *const *Y); // of four blocks

struct Rollout {
  i64 steps, first, last; // steps to take, blocks
  i64 looks;              // whether the policy sees the inputs
  Policy policy;          // or null: actions are given
  Policies policies;      // or null: blocks are asked one by one
  const char *weights, *actions;
  i64 action_time, action_environment; // strides of the given actions [bytes]
  char *out_actions;                   // (steps, B, M) or null
  i64 outputs;                         // readings to record
  const i64 *reading_offset, *reading_count, *reading_size;
  char *const *out_readings; // (steps, B, ...) each
  i64 signals, signal_bytes; // what the policy is shown beside the readings; of all of them in a record [bytes per lane]
  const i64 *signal_offset, *signal_count, *signal_size, *signal_time, *signal_environment; // strides in bytes
  const char *const *signal_from; // (steps, B or 1, ...) each
};

struct Block {
  const Model *m;
  const char *fixed;
  char *moving;
  i32 environment[W], row[W], step[W];
  const char *runs[W]; // in the table of slots, the step at which each lane is
  const i32 *seen[W];  // in the table of windows, the schedule of each lane
  bool level;   // all lanes are at the same step
  bool uniform; // and have the same schedule
};
